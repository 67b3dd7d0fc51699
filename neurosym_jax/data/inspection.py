"""What is in a recording: people, duration, rate, gaps, speeds, scenes, and what looks wrong.

`python -m neurosym_jax inspect FILE|DIR` prints it. Nothing here changes or judges the data: the
warnings are guesses from orders of magnitude, and the readers' own refusals are shown as they are.
"""

import dataclasses
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import numpy as np
import tyro

from neurosym_jax.data.formats import FORMATS, SUFFIXES, on_grid, read_any, sniff
from neurosym_jax.data.reading import AS_IT_SAYS, ReadOptions
from neurosym_jax.data.tracks import Tracks
from neurosym_jax.data.windows import cut_windows
from neurosym_jax.errors import InputError, InputWarning

__all__ = ["InspectOptions", "Summary", "inspect", "summarise", "suspicions"]

WINDOWS = ((8, 8), (8, 12))
"""Observed and forecast steps of the windows that are counted."""

FAST = 10.0
"""Metres a second; nobody walks so fast, and hardly anybody runs."""

HURRY = 2.0
"""Metres a second; a crowd whose median is faster has the wrong clock, as eth in SGAN's reading."""

ROOM = 500.0
"""Metres; a longer recorded area is more likely one in millimetres or pixels."""


@dataclasses.dataclass(frozen=True)
class InspectOptions:
    """Say what a recording, or each of a folder's, holds."""

    path: Annotated[Path, tyro.conf.Positional]
    """A file, or a folder that is searched with its subfolders."""
    figure: Path | None = None
    """A PNG of all tracks."""
    read: Annotated[ReadOptions, tyro.conf.OmitArgPrefixes] = AS_IT_SAYS
    """How files are read."""


@dataclasses.dataclass(frozen=True)
class Summary:
    """Numbers of one recording of R rows, on its own clock."""

    points: int
    people: int
    duration: float
    """Seconds from the first stamp to the last."""
    step: float
    """Seconds: the median between consecutive points of a person; NaN if nobody has two."""
    gaps: int
    """Steps longer than 1.5 times the median."""
    longest_gap: float
    """Seconds; 0 without gaps."""
    speeds: tuple[float, float, float]
    """Metres a second: median, 95th percentile and maximum, gaps left out; NaN without steps."""
    extent: tuple[float, float]
    """Metres along x and y."""
    scenes: dict[tuple[int, int], tuple[int, int]]
    """For each window of `WINDOWS`, scenes of two people or more, and people in them altogether."""


def summarise(tracks: Tracks) -> Summary:
    """The numbers of one recording; scenes are those after resampling to 0.4 s where needed."""
    step, speed = _steps(tracks)
    median = float(np.median(step)) if len(step) else np.nan
    gap = step > 1.5 * median
    plain = speed[~gap]
    middle, high, top = (np.quantile(plain, q) if len(plain) else np.nan for q in (0.5, 0.95, 1))
    width, height = np.ptp(tracks.position, axis=0)
    scenes = {}
    for obs_len, pred_len in WINDOWS:
        try:
            windows = cut_windows([on_grid(tracks)], obs_len, pred_len)
            scenes[obs_len, pred_len] = (windows.scenes, windows.agents)
        except InputError:  # too short for one window
            scenes[obs_len, pred_len] = (0, 0)
    return Summary(
        points=len(tracks.id),
        people=len(np.unique(tracks.id)),
        duration=float(np.ptp(tracks.stamp)),
        step=median,
        gaps=int(gap.sum()),
        longest_gap=float(step[gap].max()) if gap.any() else 0.0,
        speeds=(float(middle), float(high), float(top)),
        extent=(float(width), float(height)),
        scenes=scenes,
    )


def suspicions(tracks: Tracks, summary: Summary) -> list[str]:
    """What looks wrong in a recording, a line each."""
    found = []
    step, speed = _steps(tracks)
    median, _, top = summary.speeds
    whole = bool(np.all(tracks.position == np.rint(tracks.position)))
    if median > FAST:
        unit = "millimetres" if median > 300 else "pixels or centimetres"
        found.append(f"the median speed is {median:.0f} m/s: the coordinates look like {unit}")
    elif top > FAST:
        fast = np.flatnonzero((speed > FAST) & (step <= 1.5 * summary.step))
        at = np.flatnonzero(np.diff(tracks.id) == 0)[fast[0]]
        found.append(
            f"{len(fast)} steps are faster than {FAST:g} m/s (the fastest {top:.1f}), the first by "
            f"person {tracks.id[at]} at {tracks.stamp[at]:.2f} s: is a person two, or the rate off?"
        )
    if HURRY < median <= FAST:
        found.append(
            f"the median speed is {median:.2f} m/s, and people walk at 1.3: is the time between "
            "frames longer than it is taken for? (SGAN's eth needs --eth-stride 6)"
        )
    if max(summary.extent) > ROOM and not median > FAST:
        found.append(
            f"the area is {max(summary.extent):.0f} m long: are the coordinates millimetres?"
        )
    if whole and len(tracks.position) > 20 and max(summary.extent) > 20:
        found.append("all coordinates are whole numbers: they look like pixels or millimetres")
    if median < 0.02:
        found.append(
            "hardly anybody moves: the coordinates may be in kilometres, or the people sit"
        )
    order = np.lexsort((tracks.position[:, 1], tracks.position[:, 0], tracks.stamp))
    stamp, place = tracks.stamp[order], tracks.position[order]
    twins = (np.diff(stamp) == 0) & (np.diff(place, axis=0) == 0).all(axis=1)
    if twins.any():
        found.append(
            f"{twins.sum()} points are duplicates: two people at one place at one time, the first "
            f"at {stamp[np.flatnonzero(twins)[0]]:.2f} s"
        )
    if summary.step > 1.0:
        found.append(f"points are {summary.step:.2f} s apart: longer gaps than 1 s are not filled")
    return found


def _steps(tracks: Tracks) -> tuple[np.ndarray, np.ndarray]:
    """Seconds and metres a second of every step of every person, in the tracks' order."""
    same = np.diff(tracks.id) == 0
    step = np.diff(tracks.stamp)[same]
    return step, np.linalg.norm(np.diff(tracks.position, axis=0)[same], axis=1) / step


def inspect(options: InspectOptions) -> int:
    """Print what `options.path` holds; 2 if nothing in it could be read."""
    folder = options.path.is_dir()
    paths = _files(options.path) if folder else [options.path]
    recordings: list[Tracks] = []
    for path in paths:
        with warnings.catch_warnings(record=True) as told:
            warnings.simplefilter("always", InputWarning)
            try:
                found = read_any(path, options.read)
            except InputError as error:
                if not folder:
                    raise
                print(f"{error}\n")
                continue
        kind = "columns" if options.read.columns else sniff(path)
        print(f"{path}: {FORMATS[kind].text}")
        for tracks in found:
            summary = summarise(tracks)
            print("\n".join(_lines(tracks, summary)))
            for line in suspicions(tracks, summary):
                print(f"    warning: {line}")
        for warning in told:
            if issubclass(warning.category, InputWarning):
                print(f"    warning: {str(warning.message).removeprefix(f'{path}: ')}")
        print()
        recordings += found
    if len(recordings) > 1:
        print(f"altogether {len(recordings)} recordings of {len(paths)} files")
    if options.figure and recordings:
        from neurosym_jax.plotting import save_figure
        from neurosym_jax.plotting.tracks import plot_tracks

        print(f"wrote {save_figure(plot_tracks(recordings), options.figure)}")
    return 0 if recordings else 2


def _files(folder: Path) -> Sequence[Path]:
    paths = sorted(path for path in folder.rglob("*") if path.suffix.lower() in SUFFIXES)
    if not paths:
        raise InputError(f"{folder}: no {', '.join(SUFFIXES[:-1])} or {SUFFIXES[-1]} file in it")
    return paths


def _lines(tracks: Tracks, summary: Summary) -> list[str]:
    rate = "" if not summary.step > 0 else f", {1 / summary.step:.4g} points a second"
    gaps = f"{summary.gaps} gaps" + (
        f", the longest {summary.longest_gap:.2f} s" if summary.gaps else ""
    )
    median, high, top = summary.speeds
    width, height = summary.extent
    scenes = ", ".join(
        f"{obs_len}+{pred_len}: {count} ({people} people in them)"
        for (obs_len, pred_len), (count, people) in summary.scenes.items()
    )
    return [
        f"  {tracks.recording}",
        f"    people {summary.people}, points {summary.points}, duration {summary.duration:.1f} s"
        f"{rate}, {gaps}",
        f"    area {width:.1f} x {height:.1f} m, speeds median {median:.2f}, 95 % {high:.2f}, "
        f"fastest {top:.2f} m/s",
        f"    scenes {scenes}",
    ]
