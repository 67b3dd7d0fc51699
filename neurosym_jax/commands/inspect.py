"""Summarise recordings, and draw them with a forecast."""

import hashlib
import itertools
import shlex
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import tyro

from neurosym_jax.commands._options import (
    Positional,
    Reading,
    flags,
    given,
    plugin_flags,
)
from neurosym_jax.data.columns import SWAP, outside
from neurosym_jax.data.evidence import pace_of, steps_of
from neurosym_jax.data.recordings import files_in, is_folder, open_source, read_any
from neurosym_jax.data.tables import AS_IT_SAYS, FORMATS, ReadOptions
from neurosym_jax.data.tracks import GAP, Tracks, on_grid
from neurosym_jax.data.windows import Windows, cut_windows
from neurosym_jax.errors import InputError, InputWarning, printable
from neurosym_jax.models.disk import RECOMMENDED, load_model
from neurosym_jax.models.forecast import predict
from neurosym_jax.runtime.files import refuse_unwritable

__all__ = ["describe", "run"]

NAME = "NAME"
"""In the name of a figure: the recording's."""


def run(
    path: Positional[Path],
    figure: Path | None = Path(f"results/figures/tracks_{NAME}.png"),
    underlay: Annotated[
        tuple[Path, Path] | None, tyro.conf.arg(metavar="IMAGE HOMOGRAPHY")
    ] = None,
    style: Literal["paper", "talk"] = "paper",
    read: Reading = AS_IT_SAYS,
) -> int:
    """Summarise a recording, or every recording in a folder, and draw it with a forecast.

    The figure has all tracks, and what `recommended` forecasts for the moment with most
    people. The last lines are commands to go on with, in which guesses are spelled out.

    Args:
        path: A file, or a folder, which is searched with its subfolders.
        figure: File of the figure: .png, .pdf or .svg. NAME in it is the recording's
            name; the figure of another recording of this name is not overwritten.
        underlay: Image of the floor under the tracks, a map or a frame of a video, and
            a text file of 3 x 3 numbers that turn its pixels (column, row, 1) into
            metres; with FILE,row-column those of (row, column, 1), as EWAP's.
        style: Look of the figure; a talk's has larger letters and lines.
        read: How files are read.

    Returns:
        The exit status: 2 if no file in a folder could be read.

    Raises:
        InputError: for a single file that cannot be read, a folder without files, or a
            figure that cannot be written.
    """
    source = hashlib.sha256(bytes(path.resolve())).hexdigest()
    if figure:
        figure = _figure_of(figure, path, source)
        refuse_unwritable(figure)
    folder = is_folder(path)
    files = files_in(path, "**/*") if folder else [path]
    recordings: list[Tracks] = []
    for file in files:
        try:
            recordings += _described(file, read)
        except InputError as error:
            if not folder:
                raise
            print(f"{printable(str(error))}\n")
    if len(recordings) > 1:
        print(f"altogether {len(recordings)} recordings of {len(files)} files")
    if not recordings:
        return 2
    moment = _busiest_moment(recordings, read.max_gap)
    if figure:
        _draw(recordings, moment, underlay, style, figure, source)
    _print_next(path, [] if folder else recordings, moment, read)
    return 0


def _figure_of(figure: Path, path: Path, source: str) -> Path:
    """`figure` with the recording's name for NAME, and a number if another has that file.

    `source` is the digest of the recording's path, which a PNG of it holds.
    """
    from neurosym_jax.plotting.style import recording_of

    if NAME not in figure.name:
        return figure
    named = figure.with_name(figure.name.replace(NAME, path.resolve().stem))
    file = named
    for number in itertools.count(2):
        if not file.exists() or recording_of(file) == source:
            break
        file = named.with_stem(f"{named.stem}_{number}")
    return file


def _described(file: Path, read: ReadOptions) -> list[Tracks]:
    """The recordings in a file, which are described on the standard output."""
    with warnings.catch_warnings():
        # They stand in the recordings, too.
        warnings.simplefilter("ignore", InputWarning)
        recordings = read_any(file, read)
    names = {tracks.reading.format for tracks in recordings if tracks.reading}
    kinds = ", ".join(FORMATS[name].title for name in names if name)
    texts = [describe(tracks, read.max_gap) for tracks in recordings]
    print("\n".join([printable(f"{file}: {kinds}"), *texts, ""]))
    return recordings


def _draw(
    recordings: Sequence[Tracks],
    moment: Windows | None,
    underlay: tuple[Path, Path] | None,
    style: Literal["paper", "talk"],
    figure: Path,
    source: str,
) -> None:
    """Draw the tracks, and the forecast of `moment` if there is one."""
    from neurosym_jax.plotting import plot_tracks, read_underlay, save_figure, use_style

    use_style(style)
    floor = underlay and read_underlay(*underlay)
    if underlay and floor:
        pixels, homography = floor
        print(_coverage(recordings, underlay[0], homography, pixels.shape[:2]), end="")
    scene = None
    if moment:
        past, future = np.split(moment.position, [moment.obs_len], axis=1)
        samples = predict(load_model(RECOMMENDED), past)
        scene = past, future, {RECOMMENDED: samples}
    drawn = plot_tracks(recordings, floor, scene)
    print(f"wrote {save_figure(drawn, figure, source)}")


def _busiest_moment(recordings: Sequence[Tracks], max_gap: float) -> Windows | None:
    """The window of 8 + 8 steps with the most people; None if nobody is seen for so long."""
    busiest = None
    for tracks in recordings:
        try:
            windows = cut_windows(
                [on_grid(tracks, max_gap=max_gap)], 8, 8, min_agents=1
            )
        except InputError:
            continue
        at = int(windows.sizes.argmax())
        if busiest is None or windows.sizes[at] > len(busiest.agent):
            busiest = windows.take(slice(at, at + 1))
    return busiest


def _print_next(
    path: Path, recordings: Sequence[Tracks], moment: Windows | None, read: ReadOptions
) -> None:
    """Print the next commands for `path`, with what was guessed of its recordings."""
    options = _options_of(recordings, read)
    if moment is None:
        print("no forecast: nobody is seen for 6 s, 16 steps")
        file = shlex.quote(str(path))
        # A forecast needs two moments.
        if any(np.ptp(tracks.stamp) > 0 for tracks in recordings):
            words = shlex.join(["--dashboard", *flags(options), *plugin_flags()])
            print("\nnext, for people who are seen for less:")
            print(f"  neurosym replay {file} --model {RECOMMENDED} {words}")
        return
    file = shlex.quote(str(_data_of(path, moment, read)))
    people = len(moment.agent)
    options = ({} if people > 1 else {"min_agents": 1}) | options
    words = shlex.join([*flags(options), *plugin_flags()])
    print("\nnext:")
    print(f"  neurosym evaluate --data {file} --model {RECOMMENDED} {words}".rstrip())
    if people > 1:
        print(
            f"  neurosym symbols {file} --model {RECOMMENDED} --forecast {words}".rstrip()
        )


def _data_of(path: Path, moment: Windows, read: ReadOptions) -> Path:
    """What other commands can take: `path`, or where its files lie in subfolders, which they do
    not search, the folder of the busiest moment."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", InputWarning)
        try:
            open_source(path, read=read)
        except InputError:
            (reading,) = moment.reading
            return Path(reading.file).parent if reading.file else path
    return path


def _options_of(recordings: Sequence[Tracks], read: ReadOptions) -> dict[str, Any]:
    """The options that read `recordings` as they were read here, what was guessed among them."""
    options = given(read)
    reading = recordings[0].reading if recordings else None
    if reading and reading.format:
        guesses = {
            "columns": reading.columns,
            "fps": None if read.eth_stride else reading.rate,
        }
        uses = FORMATS[reading.format].uses or ()
        guesses = {
            name: guess for name, guess in guesses.items() if guess and name in uses
        }
        return guesses | options
    return options


def describe(tracks: Tracks, max_gap: float = AS_IT_SAYS.max_gap) -> str:
    """People, duration, gaps, speeds and scenes of a recording, and what looks wrong in it."""
    step, speed = steps_of(tracks)
    usual = float(np.median(step)) if len(step) else np.nan
    gap = step > GAP * usual
    rate = f", {1 / usual:.4g} points a second" if usual > 0 else ""
    longest = f", the longest {step[gap].max():.2f} s" if gap.any() else ""
    speeds = "unknown"
    if len(step):
        median, fastest = np.quantile(speed[~gap], (0.5, 1))
        speeds = f"median {median:.2f}, fastest {fastest:.2f} m/s"
    width, height = np.ptp(tracks.position, axis=0)
    lines = [
        f"  {printable(tracks.recording)}",
        f"    people {len(np.unique(tracks.id))}, points {len(tracks.id)}, duration "
        f"{np.ptp(tracks.stamp):.1f} s{rate}, {gap.sum()} gaps{longest}",
        f"    area {width:.1f} x {height:.1f} m, speeds {speeds}",
    ]
    _, pace = pace_of(tracks)
    if not np.isnan(pace):
        lines.append(f"    one step in twenty is faster than {pace:.2f} m/s")
    short, long = _scenes(tracks, 8, max_gap), _scenes(tracks, 12, max_gap)
    lines.append(f"    scenes 8+8: {short}, 8+12: {long}")
    if tracks.reading:
        if tracks.reading.rate:
            lines.append(f"    {tracks.reading.rate:g} frame numbers a second")
        lines += [f"    {printable(note)}" for note in tracks.reading.notes]
        lines += [f"    warning: {printable(line)}" for line in tracks.reading.warnings]
    return "\n".join(lines)


def _coverage(
    recordings: Sequence[Tracks],
    image: Path,
    homography: np.ndarray,
    shape: tuple[int, int],
) -> str:
    """A warning where tracks lie outside a picture of `shape` (height, width), else nothing."""
    position = np.concatenate([tracks.position for tracks in recordings])
    height, width = shape
    missed = outside(homography, position, width, height)
    other = outside(homography @ SWAP, position, width, height)
    hint = f" (HOMOGRAPHY,row-column: {other:.0%})" if other < missed / 2 else ""
    line = f"warning: {missed:.0%} of the points lie outside {image.name}{hint}\n"
    return printable(line.strip()) + "\n" if missed > 0.05 else ""


def _scenes(tracks: Tracks, pred_len: int, max_gap: float) -> str:
    try:
        windows = cut_windows([on_grid(tracks, max_gap=max_gap)], 8, pred_len)
    except InputError:  # too short for one window
        return "0"
    return f"{windows.scenes} ({windows.agents} people in them)"
