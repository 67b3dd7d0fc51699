"""Summaries of recordings: people, duration, rate, gaps, speeds and scenes."""

import dataclasses
from collections.abc import Iterable

import numpy as np

from neurosym_jax.data.reading import Reading
from neurosym_jax.data.suspicions import GAP, steps_of
from neurosym_jax.data.tracks import Tracks, on_grid
from neurosym_jax.data.windows import cut_windows
from neurosym_jax.errors import InputError, printable

__all__ = ["Summary", "describe", "describe_readings", "summarise"]

WINDOWS = ((8, 8), (8, 12))
"""Observed and predicted steps of the windows that are counted."""


@dataclasses.dataclass(frozen=True)
class Summary:
    """Numbers of one recording, on its own clock."""

    points: int
    people: int
    duration: float
    """Seconds from the first stamp to the last."""
    step: float
    """Median seconds between consecutive points of a person; NaN without two of any."""
    gaps: int
    """Steps of a person longer than 1.5 times the median."""
    longest_gap: float
    """Seconds; 0 without gaps."""
    speeds: tuple[float, float, float]
    """Metres a second: median, 95th percentile and maximum, gaps left out; NaN without steps."""
    extent: tuple[float, float]
    """Metres along x and y."""
    scenes: dict[tuple[int, int], tuple[int, int]]
    """For each of `WINDOWS`, the number of scenes of two people or more, and people in them."""


def summarise(tracks: Tracks) -> Summary:
    """Summarise one recording; scenes are counted after resampling to 0.4 s where needed."""
    step, speed = steps_of(tracks)
    median = float(np.median(step)) if len(step) else np.nan
    gap = step > GAP * median
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


def describe_readings(readings: Iterable[Reading]) -> str:
    """A line for each recording read from a file: format, rows and gaps in time."""
    lines = []
    for how in {(how.file, how.recording): how for how in readings}.values():
        if how.file is None:
            continue
        parts = [f"{how.format}, {how.rows} rows"]
        parts += [f"{how.skipped} skipped"] * (how.skipped > 0)
        parts += [f"{how.gaps} gaps in time between {how.runs} runs"] * (how.gaps > 0)
        lines.append(f"read {printable(how.recording)}: {', '.join(parts)}")
    return "\n".join(lines)


def describe(tracks: Tracks) -> str:
    """The summary of a recording as text, with what looks wrong in it."""
    summary = summarise(tracks)
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
    lines = [
        f"  {printable(tracks.recording)}",
        f"    people {summary.people}, points {summary.points}, duration {summary.duration:.1f} s"
        f"{rate}, {gaps}",
        f"    area {width:.1f} x {height:.1f} m, speeds median {median:.2f}, 95 % {high:.2f}, "
        f"fastest {top:.2f} m/s",
        f"    scenes {scenes}",
    ]
    found = tracks.reading.warnings if tracks.reading else ()
    return "\n".join([*lines, *(f"    warning: {printable(line)}" for line in found)])
