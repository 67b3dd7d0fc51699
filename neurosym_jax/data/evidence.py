"""Whether a recording's clock and unit can be true, by how people move in it.

Speeds are taken over steps of about 0.4 s, so that noise of a fast tracker is not
walking.
"""

import dataclasses
import itertools
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
import polars as pl

from neurosym_jax.data.tables import GUARDS
from neurosym_jax.data.tracks import GAP, PERIOD, Tracks
from neurosym_jax.errors import option

__all__ = [
    "DOUBTED",
    "REFUSED",
    "Doubt",
    "doubts_of",
    "judge",
    "pace_of",
    "roughness",
    "steps_of",
    "strides_of",
]

REFUSED, DOUBTED = (0.9, 4.5), (1.05, 2.5)
"""Outside these paces, m/s, a recording is refused or doubted. Those of ETH/UCY and THÖR are 1.22
to 2.06, SGAN's eth 3.23 (`python -m studies.bands`)."""
WALK = 1.5  # m/s, a usual pace
FEW, ENOUGH = 10, 100  # steps that say anything of a recording, and that may refuse one
MANY = 20  # fewest people of whom a share is judged
CROWDED = np.nextafter(0.2, 0)  # metres within which two people stand at one place


def strides_of(tracks: Tracks) -> tuple[np.ndarray, np.ndarray]:
    """[R - 1] seconds and metres from each row to the next of the same person; NaN to another's."""
    step = np.diff(tracks.stamp)
    length = np.linalg.norm(np.diff(tracks.position, axis=0), axis=1)
    is_other = np.diff(tracks.id) != 0
    return np.where(is_other, np.nan, step), np.where(is_other, np.nan, length)


def steps_of(tracks: Tracks) -> tuple[np.ndarray, np.ndarray]:
    """Seconds and m/s of every step of every person, in the order of the tracks."""
    step, length = strides_of(tracks)
    same = np.isfinite(step)
    return step[same], length[same] / step[same]


def pace_of(tracks: Tracks) -> tuple[int, float]:
    """Number of steps, and the speed that one in twenty exceeds; NaN where it says nothing."""
    step, _ = strides_of(tracks)
    same = np.isfinite(step)
    longest = GAP * PERIOD
    if same.any():
        longest = GAP * max(float(np.median(step[same])), PERIOD)
    clock = np.append(0.0, np.cumsum(np.where(same, step, 2 * longest)))
    # Strides to the same person's row about 0.4 s later, or of short tracks to the
    # next.
    after = np.searchsorted(clock, clock + PERIOD - 1e-3)
    starts = np.flatnonzero(after < len(clock))
    starts = starts[clock[after[starts]] - clock[starts] <= longest]
    if len(starts) < FEW:
        starts = np.flatnonzero(same)
        after = np.arange(len(clock)) + 1
    if len(starts) < FEW:
        return len(starts), np.nan
    after = after[starts]
    time = tracks.stamp[after] - tracks.stamp[starts]
    move = tracks.position[after] - tracks.position[starts]
    speed = np.linalg.norm(move, axis=1) / time
    return len(starts), float(np.quantile(speed, 0.95))


def roughness(time: np.ndarray, ids: np.ndarray, columns: np.ndarray) -> np.ndarray:
    """[C] typical second difference of each of the `columns` [R, C] along tracks, in spreads.

    It is infinite where the reading repeats a person at one moment, or has few tracks
    of three rows.
    """
    order = np.lexsort((time, ids))
    step = np.diff(time[order])
    same = np.diff(ids[order]) == 0
    triple = same[1:] & same[:-1]
    is_twice = same & (step == 0)
    if is_twice.any() or triple.sum() < 0.3 * len(time):
        return np.full(columns.shape[1], np.inf)
    bend = np.abs(np.diff(columns[order], 2, axis=0))[triple]
    low, high = np.quantile(columns, (0.05, 0.95), axis=0)
    spread = np.maximum(high - low, 1e-12)
    return np.median(bend, axis=0) / spread


def _every_period(tracks: Tracks) -> Tracks:
    """The tracks with points of a person about 0.4 s apart: between two frames of a video, whole
    pixels stay and leap although nothing is held."""
    steps, _ = steps_of(tracks)
    usual = np.median(steps) if len(steps) else PERIOD
    stride = max(1, np.rint(PERIOD / max(usual, 1e-3)))
    place = np.arange(len(tracks.id)) - np.searchsorted(tracks.id, tracks.id)
    return tracks.take(place % stride == 0)


def _is_crowded(position: np.ndarray) -> bool:
    """Whether any of the people who begin together [N, 2] stand within 0.2 m of another: people on
    one clock do not, those who came one after another through one door do."""
    from scipy.spatial import KDTree  # It takes a third of a second to import.

    return bool(len(KDTree(position).query_pairs(CROWDED)))


class Doubt(NamedTuple):
    """What the moves of people say against a recording."""

    guard: str
    refuses: bool  # or only doubts
    line: str


def judge(tracks: Tracks) -> Iterator[Doubt]:
    """What is doubted of a recording, and what refuses it, in the order of the guards."""
    steps, pace = pace_of(tracks)
    enough = steps >= ENOUGH
    thin = _every_period(tracks)
    _, length = strides_of(thin)
    _, first, count = np.unique(thin.id, return_index=True, return_counts=True)
    last = first + count - 1

    doubts = [_walking(pace)]
    if steps >= FEW:
        doubts.append(_held(length))
    if len(first) >= MANY:
        doubts += [_ends(thin, length, first, last), _starts(thin, first, last)]
    if enough:
        doubts.append(_line(tracks))
    doubts += [_twins(tracks), _leaps(tracks)]
    for doubt in itertools.chain(*doubts):
        yield doubt._replace(refuses=bool(doubt.refuses and enough))


def doubts_of(tracks: Tracks) -> int:
    """How many guards doubt tracks whatever their unit and rate, as columns do that are no positions.

    Steps along one line are a doubt more: a coordinate that stands twice.
    """
    same = np.diff(tracks.id) == 0
    if same.sum() < FEW:
        return len(GUARDS)
    step = np.median(np.diff(tracks.stamp)[same])
    tracks = dataclasses.replace(tracks, stamp=tracks.stamp / step * PERIOD)
    _, pace = pace_of(tracks)
    if pace > 0:
        tracks = dataclasses.replace(tracks, position=tracks.position * WALK / pace)
    moves = np.diff(tracks.position, axis=0)[same]
    across, along = np.linalg.eigvalsh(np.cov(moves.T))
    doubts = int(across < 1e-4 * along)
    for doubt in judge(tracks):
        doubts += doubt.guard not in ("slow", "fast")
    return doubts


def _walking(pace: float) -> Iterator[Doubt]:
    if not (pace < DOUBTED[0] or pace > DOUBTED[1]):
        return
    guard, unit = "fast", "cm, mm or pixels"
    if pace < 2:
        guard, unit = "slow", "more than metres"
    line = (
        f"one step in twenty is faster than {pace:.2f} m/s, of walking people 1.2 to 2.1: is "
        f"the clock too {guard} ({option('fps')}, {option('time_unit')}; SGAN's eth needs "
        f"{option('eth_stride', 6)}), or are coordinates {unit} ({option('unit')})?"
    )
    yield Doubt(guard, not REFUSED[0] <= pace <= REFUSED[1], line)


def _held(length: np.ndarray) -> Iterator[Doubt]:
    """A position that is held repeats, and the next one makes up for it."""
    usual = np.inf
    if np.any(length > 0):
        usual = np.median(length[length > 0])
    stay, leap, after = length[:-2], length[1:-1], length[2:]
    least = np.maximum(1.6 * after, 0.5 * usual)
    is_held = (stay == 0) & (leap > least)
    share = np.sum(is_held) / (len(length) + 1)
    if share > 0.01:
        line = (
            f"{share:.1%} of the points repeat the one before and are followed by a leap: are "
            "positions held until the next is there?"
        )
        yield Doubt("held", share > 0.1, line)


def _ends(
    tracks: Tracks, length: np.ndarray, first: np.ndarray, last: np.ndarray
) -> Iterator[Doubt]:
    """People who walk, and stay for three steps where their tracks begin or end."""
    padded = np.pad(length, 3, constant_values=np.nan)
    three = np.arange(3)
    begins = padded[first[:, None] + 3 + three].sum(axis=1) == 0
    ends = padded[last[:, None] + three].sum(axis=1) == 0
    way = tracks.position[last] - tracks.position[first]
    share = np.mean((np.linalg.norm(way, axis=1) > 1) & (begins | ends))
    if share > 0.2:
        line = f"{share:.0%} of the people walk but stay at an end: are positions held?"
        yield Doubt("ends", share > 0.5, line)


def _starts(tracks: Tracks, first: np.ndarray, last: np.ndarray) -> Iterator[Doubt]:
    """People who begin at one place, or at one moment without leaving at one."""
    _, counts = np.unique(tracks.position[first], axis=0, return_counts=True)
    share = counts.max() / len(first)
    if share > 0.5:
        line = f"{share:.0%} of the people begin at one place: has each an own origin?"
        yield Doubt("origins", True, line)

    together = tracks.stamp[first] == tracks.stamp.min()
    share = np.mean(together)
    if share > 0.9 and len(np.unique(tracks.stamp[last])) > len(first) / 4:
        line = f"{share:.0%} of the people begin at one moment: has each an own clock?"
        yield Doubt("together", _is_crowded(tracks.position[first[together]]), line)


def _line(tracks: Tracks) -> Iterator[Doubt]:
    variance, _ = np.linalg.eigvalsh(np.cov(tracks.position.T, bias=True))
    across = np.sqrt(np.abs(variance))
    if across < 0.2 and len(np.unique(tracks.id)) > 1:
        line = f"all are within {across:.2f} m of a line: is x or y a height, or both alike?"
        yield Doubt("line", False, line)


def _twins(tracks: Tracks) -> Iterator[Doubt]:
    # In moments of 0.1 s or the usual step: two trackers may have their own stamps.
    steps, _ = steps_of(tracks)
    length = min(0.1, np.median(np.append(steps, 0.1)))
    moment = np.rint(tracks.stamp / length)
    points = pl.DataFrame([tracks.id, moment, *tracks.position.T])
    points = points.unique(["column_0", "column_1"], keep="first")
    is_twin = points.drop("column_0").is_duplicated()
    count = is_twin.sum()
    if count:
        line = f"{count} points are another person's, too: is everybody there twice?"
        yield Doubt("twins", count > 0.1 * len(is_twin), line)


def _leaps(tracks: Tracks) -> Iterator[Doubt]:
    step, length = strides_of(tracks)
    count = np.isfinite(step).sum()
    if count < FEW:
        return
    is_leap = (length > 10 * step) & (step <= GAP * np.nanmedian(step))
    at = np.flatnonzero(is_leap)
    if 0 < len(at) < count / 2:
        person, stamp = tracks.id[at[0]], tracks.stamp[at[0]]
        first = f"the first by person {person} at {stamp:.2f} s"
        line = f"{len(at)} steps are faster than 10 m/s, {first}: is a person two?"
        yield Doubt("leaps", False, line)
