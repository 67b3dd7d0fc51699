"""Summarise a recording, or every recording in a folder."""

import dataclasses
import warnings
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
import tyro

from neurosym_jax.commands._options import refuse_unused
from neurosym_jax.data.evidence import pace_of, steps_of
from neurosym_jax.data.formats import FORMATS, files_in, is_folder, read_any
from neurosym_jax.data.reading import AS_IT_SAYS, ReadOptions
from neurosym_jax.data.tracks import GAP, Tracks, on_grid
from neurosym_jax.data.windows import cut_windows
from neurosym_jax.errors import InputError, InputWarning, printable

__all__ = ["Options", "describe", "run"]


@dataclasses.dataclass(frozen=True)
class Options:
    """Summarise a recording, or every recording in a folder."""

    path: Annotated[Path, tyro.conf.Positional]
    """A file, or a folder, which is searched with its subfolders."""
    figure: Path | None = None
    """File for a figure of all tracks: .png, .pdf or .svg."""
    underlay: Annotated[tuple[Path, Path] | None, tyro.conf.arg(metavar="IMAGE HOMOGRAPHY")] = None
    """Image of the floor under the tracks, a map or a frame of a video, and a text file of 3 x 3
    numbers that turn its pixels (column, row, 1) into metres."""
    style: Literal["paper", "talk"] = "paper"
    """Look of the figure; a talk's has larger letters and lines."""
    read: Annotated[ReadOptions, tyro.conf.OmitArgPrefixes] = AS_IT_SAYS
    """How files are read."""


def run(options: Options) -> int:
    """Print the summaries; return 2 if no file in a folder could be read.

    Raises:
        InputError: for a single file that cannot be read, a folder without files, or an option
            that is not used.
    """
    if options.figure is None:
        refuse_unused(options, ["underlay", "style"], "without --figure")
    folder = is_folder(options.path)
    paths = files_in(options.path, "**/*") if folder else [options.path]
    recordings: list[Tracks] = []
    for path in paths:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", InputWarning)  # They stand in the recordings, too.
            try:
                found = read_any(path, options.read)
            except InputError as error:
                if not folder:
                    raise
                print(f"{printable(str(error))}\n")
                continue
        names = {tracks.reading.format for tracks in found if tracks.reading}
        kinds = ", ".join(FORMATS[name].title for name in names if name)
        said = [describe(tracks, options.read.max_gap) for tracks in found]
        print("\n".join([printable(f"{path}: {kinds}"), *said, ""]))
        recordings += found
    if len(recordings) > 1:
        print(f"altogether {len(recordings)} recordings of {len(paths)} files")
    if options.figure and recordings:
        from neurosym_jax.plotting import plot_tracks, read_underlay, save_figure, use_style

        use_style(options.style)
        floor = options.underlay and read_underlay(*options.underlay)
        print(f"wrote {save_figure(plot_tracks(recordings, floor), options.figure)}")
    return 0 if recordings else 2


def describe(tracks: Tracks, max_gap: float = AS_IT_SAYS.max_gap) -> str:
    """People, duration, gaps, speeds and scenes of a recording, and what looks wrong in it."""
    step, speed = steps_of(tracks)
    usual = float(np.median(step)) if len(step) else np.nan
    gap = step > GAP * usual
    rate = f", {1 / usual:.4g} points a second" if usual > 0 else ""
    longest = f", the longest {step[gap].max():.2f} s" if gap.any() else ""
    middle, top = np.quantile(speed[~gap], (0.5, 1)) if len(step) else (np.nan, np.nan)
    width, height = np.ptp(tracks.position, axis=0)
    lines = [
        f"  {printable(tracks.recording)}",
        f"    people {len(np.unique(tracks.id))}, points {len(tracks.id)}, duration "
        f"{np.ptp(tracks.stamp):.1f} s{rate}, {gap.sum()} gaps{longest}",
        f"    area {width:.1f} x {height:.1f} m, speeds median {middle:.2f}, fastest {top:.2f} m/s",
        f"    one step in twenty is faster than {pace_of(tracks)[1]:.2f} m/s",
        f"    scenes 8+8: {_scenes(tracks, 8, max_gap)}, 8+12: {_scenes(tracks, 12, max_gap)}",
    ]
    warned = tracks.reading.warnings if tracks.reading else ()
    return "\n".join([*lines, *(f"    warning: {printable(line)}" for line in warned)])


def _scenes(tracks: Tracks, pred_len: int, max_gap: float) -> str:
    try:
        windows = cut_windows([on_grid(tracks, max_gap=max_gap)], 8, pred_len)
    except InputError:  # too short for one window
        return "0"
    return f"{windows.scenes} ({windows.agents} people in them)"
