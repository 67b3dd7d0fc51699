"""Whether a recording's clock and unit can be true: how people move in it, against reference bands.

Numbers are taken over steps of about 0.4 s, whatever the recording's own rate, so that noise of a
fast tracker does not count as walking. What lies outside a band is refused or doubted, with the
option that settles it.
"""

from typing import NamedTuple

import numpy as np

from neurosym_jax.data.reading import ReadOptions
from neurosym_jax.data.tracks import GAP, PERIOD, Tracks

__all__ = ["BANDS", "Band", "judge", "measure", "steps_of"]

FEW, ENOUGH = 10, 100
"""Fewer steps say nothing of a recording; fewer than `ENOUGH` are no reason to refuse one."""

CROWD = 20
"""People who do not all begin at one moment, unless each has a clock of their own."""


class Band(NamedTuple):
    """The values that a number of true recordings has."""

    refused: tuple[float, float]
    """Outside, a recording is refused."""
    doubted: tuple[float, float]
    """Outside, a recording is warned of."""
    low: str
    """What lower values suggest."""
    high: str


BANDS = {
    "pace": Band(
        (0.9, 4.5),
        (1.05, 2.5),
        "is the clock too slow (--fps, --time-unit), or are the coordinates more than metres "
        "(--unit METRES)?",
        "is the clock too fast (--fps, --time-unit; SGAN's eth needs --eth-stride 6), or are the "
        "coordinates cm, mm or pixels (--unit)?",
    ),
    "distance": Band(
        (0.2, np.inf),
        (0.35, np.inf),
        "are the coordinates more than metres (--unit METRES), or is everybody there twice?",
        "",
    ),
    "turning": Band((0, 1.2), (0, 0.6), "", "are ids mixed up, or are positions noise?"),
    "frozen": Band((0, 0.1), (0, 0.01), "", "are positions held until the next is there?"),
}
"""Of ETH/UCY and THÖR, `python -m studies.bands`: pace 1.22 to 3.23 (SGAN's eth; else 2.06),
distance 0.46 to 2.23, turning 0.00 to 0.15, frozen 0.00."""

_TEXTS = {
    "pace": "one step in twenty is faster than {:.2f} m/s, of walking people 1.2 to 2.1",
    "distance": "a quarter of the people are within {:.2f} m of another, usually 0.5 m or more",
    "turning": "people turn by {:.1f} rad at every step",
    "frozen": "{:.1%} of the points repeat the one before and are followed by a leap",
}


def steps_of(tracks: Tracks) -> tuple[np.ndarray, np.ndarray]:
    """Seconds and m/s of every step of every person, in the order of the tracks."""
    same = np.diff(tracks.id) == 0
    step = np.diff(tracks.stamp)[same]
    return step, np.linalg.norm(np.diff(tracks.position, axis=0)[same], axis=1) / step


def measure(tracks: Tracks) -> dict[str, float]:
    """The numbers of `BANDS` for a recording, and `steps`; those that it is too small for are left
    out.

    pace: 95 % quantile of speeds, m/s. distance: 25 % quantile of the distance to the nearest
    person, metres. turning: median change of heading from step to step of people who move, rad.
    frozen: share of points that repeat the one before and are followed by a leap.
    """
    here, after = _strides(tracks)
    found: dict[str, float] = {"steps": len(here)}
    if len(here) < FEW:
        return found
    move = tracks.position[after] - tracks.position[here]
    length = np.linalg.norm(move, axis=1)
    time = tracks.stamp[after] - tracks.stamp[here]
    pace = float(np.quantile(length / time, 0.95))
    if pace > 1 or np.median(time) > PERIOD / 2:  # In a moment anybody may stand.
        found["pace"] = pace
    stride = np.full(len(tracks.id), -1)
    stride[here] = np.arange(len(here))
    goes_on = np.flatnonzero(stride[after] >= 0)
    next_ = stride[after[goes_on]]
    moves = np.minimum(length[goes_on], length[next_]) > 0.3 * np.quantile(length, 0.9)
    one, two = move[goes_on[moves]], move[next_[moves]]
    if len(one) >= FEW:
        cross = one[:, 0] * two[:, 1] - one[:, 1] * two[:, 0]
        found["turning"] = float(np.median(np.abs(np.arctan2(cross, np.sum(one * two, axis=1)))))
    found["frozen"] = float(_held(tracks).mean())
    near = _nearest(tracks)
    if len(near) >= ENOUGH:
        found["distance"] = float(np.quantile(near, 0.25))
    return found


def judge(tracks: Tracks, options: ReadOptions) -> tuple[list[str], list[str]]:
    """Reasons to refuse a recording, and to doubt it, a line each."""
    refused: list[str] = []
    doubted: list[str] = []
    found = measure(tracks)
    reason = refused if found["steps"] >= ENOUGH else doubted
    for name, band in BANDS.items():
        value = found.get(name)
        if value is None or band.doubted[0] <= value <= band.doubted[1]:
            continue
        outside = not band.refused[0] <= value <= band.refused[1]
        why = band.low if value < band.doubted[0] else band.high
        (reason if outside else doubted).append(f"{_TEXTS[name].format(value)}: {why}")
    whole = bool(np.all(tracks.position == np.rint(tracks.position)))
    if whole and options.unit is None and len(tracks.id) > 20 and np.ptp(tracks.position) > 20:
        reason.append(
            "all coordinates are whole numbers, as pixels or millimetres are: say --unit m, cm, mm "
            "or the metres of a pixel"
        )
    ids, first = np.unique(tracks.id, return_index=True)
    last = np.append(first[1:], len(tracks.id)) - 1
    together = np.mean(tracks.stamp[first] == tracks.stamp.min())
    ends = len(np.unique(tracks.stamp[last]))
    if len(ids) >= CROWD and together > 0.9 and ends > len(ids) / 4:
        reason.append(
            f"{together:.0%} of the {len(ids)} people begin at one moment and end at {ends}: has "
            "each a clock that begins at 0? Add when each begins"
        )
    return refused, [*doubted, *_oddities(tracks)]


def _oddities(tracks: Tracks) -> list[str]:
    """Single points that look wrong, and steps that are not filled."""
    found = []
    step, speed = steps_of(tracks)
    usual = float(np.median(step)) if len(step) else 0.0
    fast = np.flatnonzero((speed > 10) & (step <= GAP * usual)) if len(step) >= FEW else []
    if 0 < len(fast) < len(step) / 2:
        at = np.flatnonzero(np.diff(tracks.id) == 0)[fast[0]]
        found.append(
            f"{len(fast)} steps are faster than 10 m/s (the fastest {speed[fast].max():.1f}), the "
            f"first by person {tracks.id[at]} at {tracks.stamp[at]:.2f} s: is a person two?"
        )
    order = np.lexsort((tracks.position[:, 1], tracks.position[:, 0], tracks.stamp))
    stamp, place = tracks.stamp[order], tracks.position[order]
    twins = (np.diff(stamp) == 0) & (np.diff(place, axis=0) == 0).all(axis=1)
    if twins.any():
        found.append(
            f"{twins.sum()} points are duplicates: two people at one place at one time, the first "
            f"at {stamp[np.flatnonzero(twins)[0]]:.2f} s"
        )
    if usual > 1.0:
        found.append(
            f"points are {usual:.2f} s apart, and longer gaps than --max-gap are not filled "
            "(--time-unit says what a table's times count)"
        )
    return found


def _strides(tracks: Tracks) -> tuple[np.ndarray, np.ndarray]:
    """Rows, and for each the first row of the same person that is about 0.4 s later.

    Of tracks that are shorter, so that there are hardly any, each row and the next.
    """
    step, same = np.diff(tracks.stamp), np.diff(tracks.id) == 0
    longest = GAP * max(float(np.median(step[same])) if same.any() else 0.0, PERIOD)
    clock = np.append(0.0, np.cumsum(np.where(same, step, 2 * longest)))
    after = np.searchsorted(clock, clock + PERIOD - 1e-3)
    here = np.flatnonzero(after < len(clock))
    here = here[clock[after[here]] - clock[here] <= longest]
    if len(here) < FEW:
        here = np.flatnonzero(same)
        return here, here + 1
    return here, after[here]


def _held(tracks: Tracks) -> np.ndarray:
    """[R] bool: the last of points at one place, which a step far longer than the next follows."""
    length = np.linalg.norm(np.diff(tracks.position, axis=0), axis=1)
    length[np.diff(tracks.id) != 0] = np.nan
    leap = 1.6 * np.append(length[2:], [np.nan, np.nan])[: len(length) - 1]
    moving = length[length > 0]
    held = np.zeros(len(tracks.id), bool)
    if len(moving):
        far = (length[1:] > leap) & (length[1:] > 0.5 * np.median(moving))
        held[1:-1] = (length[:-1] == 0) & far
    return held


def _nearest(tracks: Tracks) -> np.ndarray:
    """Distances to the nearest person, metres, at up to 200 moments with two people or more."""
    order = np.argsort(tracks.stamp, kind="stable")
    stamp, place = tracks.stamp[order], tracks.position[order]
    bounds = np.append(np.flatnonzero(np.diff(stamp, prepend=-np.inf)), len(stamp))
    many = np.flatnonzero(np.diff(bounds) > 1)
    found = [np.zeros(0)]
    for at in many[:: max(1, len(many) // 200)]:
        people = place[bounds[at] : bounds[at + 1]][:300]
        apart = np.linalg.norm(people[:, None] - people[None], axis=-1)
        np.fill_diagonal(apart, np.inf)
        found.append(apart.min(axis=1))
    return np.concatenate(found)
