"""Summarise a recording, or every recording in a folder."""

import warnings
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
import tyro

from neurosym_jax.commands._options import Positional, Reading, refuse_given
from neurosym_jax.data.clock import on_grid
from neurosym_jax.data.evidence import pace_of, steps_of
from neurosym_jax.data.formats import FORMATS, files_in, is_folder, read_any
from neurosym_jax.data.geometry import SWAP, outside
from neurosym_jax.data.reading import AS_IT_SAYS
from neurosym_jax.data.tracks import GAP, Tracks
from neurosym_jax.data.windows import cut_windows
from neurosym_jax.errors import InputError, InputWarning, printable

__all__ = ["describe", "run"]


def run(
    path: Positional[Path],
    figure: Path | None = None,
    underlay: Annotated[tuple[Path, Path] | None, tyro.conf.arg(metavar="IMAGE HOMOGRAPHY")] = None,
    style: Literal["paper", "talk"] = "paper",
    read: Reading = AS_IT_SAYS,
) -> int:
    """Summarise a recording, or every recording in a folder.

    Args:
        path: A file, or a folder, which is searched with its subfolders.
        figure: File for a figure of all tracks: .png, .pdf or .svg.
        underlay: Image of the floor under the tracks, a map or a frame of a video, and a text file
            of 3 x 3 numbers that turn its pixels (column, row, 1) into metres; with
            FILE,row-column those of (row, column, 1), as EWAP's.
        style: Look of the figure; a talk's has larger letters and lines.
        read: How files are read.

    Returns:
        The exit status: 2 if no file in a folder could be read.

    Raises:
        InputError: for a single file that cannot be read, a folder without files, or an option
            that is not used.
    """
    if figure is None:
        refuse_given("without --figure", underlay=underlay, style=style != "paper")
    folder = is_folder(path)
    files = files_in(path, "**/*") if folder else [path]
    recordings: list[Tracks] = []
    for file in files:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", InputWarning)  # They stand in the recordings, too.
            try:
                found = read_any(file, read)
            except InputError as error:
                if not folder:
                    raise
                print(f"{printable(str(error))}\n")
                continue
        names = {tracks.reading.format for tracks in found if tracks.reading}
        kinds = ", ".join(FORMATS[name].title for name in names if name)
        said = [describe(tracks, read.max_gap) for tracks in found]
        print("\n".join([printable(f"{file}: {kinds}"), *said, ""]))
        recordings += found
    if len(recordings) > 1:
        print(f"altogether {len(recordings)} recordings of {len(files)} files")
    if figure and recordings:
        from neurosym_jax.plotting import plot_tracks, read_underlay, save_figure, use_style

        use_style(style)
        floor = underlay and read_underlay(*underlay)
        if underlay and floor:
            print(_coverage(recordings, underlay[0], floor[1], floor[0].shape[:2]), end="")
        print(f"wrote {save_figure(plot_tracks(recordings, floor), figure)}")
    return 0 if recordings else 2


def describe(tracks: Tracks, max_gap: float = AS_IT_SAYS.max_gap) -> str:
    """People, duration, gaps, speeds and scenes of a recording, and what looks wrong in it."""
    step, speed = steps_of(tracks)
    usual = float(np.median(step)) if len(step) else np.nan
    gap = step > GAP * usual
    rate = f", {1 / usual:.4g} points a second" if usual > 0 else ""
    longest = f", the longest {step[gap].max():.2f} s" if gap.any() else ""
    speeds = (
        "median {:.2f}, fastest {:.2f} m/s".format(*np.quantile(speed[~gap], (0.5, 1)))
        if len(step)
        else "unknown"
    )
    pace = pace_of(tracks)[1]
    width, height = np.ptp(tracks.position, axis=0)
    lines = [
        f"  {printable(tracks.recording)}",
        f"    people {len(np.unique(tracks.id))}, points {len(tracks.id)}, duration "
        f"{np.ptp(tracks.stamp):.1f} s{rate}, {gap.sum()} gaps{longest}",
        f"    area {width:.1f} x {height:.1f} m, speeds {speeds}",
        *([] if np.isnan(pace) else [f"    one step in twenty is faster than {pace:.2f} m/s"]),
        f"    scenes 8+8: {_scenes(tracks, 8, max_gap)}, 8+12: {_scenes(tracks, 12, max_gap)}",
    ]
    if tracks.reading:
        lines += [f"    {printable(note)}" for note in tracks.reading.notes]
        lines += [f"    warning: {printable(line)}" for line in tracks.reading.warnings]
    return "\n".join(lines)


def _coverage(
    recordings: list[Tracks], image: Path, homography: np.ndarray, shape: tuple[int, int]
) -> str:
    """A warning where tracks lie outside a picture of `shape` (height, width), else nothing."""
    position = np.concatenate([tracks.position for tracks in recordings])
    missed, other = (
        outside(matrix, position, shape[1], shape[0]) for matrix in (homography, homography @ SWAP)
    )
    hint = f" (HOMOGRAPHY,row-column: {other:.0%})" if other < missed / 2 else ""
    line = f"warning: {missed:.0%} of the points lie outside {image.name}{hint}\n"
    return printable(line.strip()) + "\n" if missed > 0.05 else ""


def _scenes(tracks: Tracks, pred_len: int, max_gap: float) -> str:
    try:
        windows = cut_windows([on_grid(tracks, max_gap=max_gap)], 8, pred_len)
    except InputError:  # too short for one window
        return "0"
    return f"{windows.scenes} ({windows.agents} people in them)"
