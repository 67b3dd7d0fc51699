"""Tracks made of THÖR and THÖR-MAGNI, in the files in which they are handed on.

- Tracklets of THÖR-MAGNI: `Time,...,x,y,...,ag_id,...,tracklet_id` in metres.
- Tracks of CLiFF-LHMP: `time,id,x,y,speed,heading` in metres, no header; every agent has a clock
  of its own, so `tracks.resample` must bring them to one grid before they are a scene.

Sources: T. Schreiter et al., "THÖR-MAGNI", IJRR 2024; Y. Zhu et al., "CLiFF-LHMP", IROS 2023.
Nothing is smoothed or filled in here.
"""

from array import array
from pathlib import Path

import numpy as np

from neurosym_jax.data.format import Format
from neurosym_jax.data.rows import (
    People,
    assemble,
    consecutive,
    number_table,
    refuse_unwhole,
)
from neurosym_jax.data.tables import read_table
from neurosym_jax.data.text import Head, read_number
from neurosym_jax.data.tracks import Tracks
from neurosym_jax.errors import InputError, printable

__all__ = ["FORMATS", "TRACKLET_COLUMNS", "read_cliff", "read_tracklets"]

TRACKLET_COLUMNS = ("Time", "x", "y", "tracklet_id", "ag_id")

_CLIFF = ("time", "id", "x", "y", "speed", "heading")


def read_tracklets(path: Path) -> list[Tracks]:
    """The runs in a file of THÖR-MAGNI tracklets, in which nothing but the order tells them apart.

    A tracklet is a part of one helmet's way in one run, and tracklets are numbered run by run;
    where a helmet comes back at an earlier time than it had, the next run begins. Tracklets of a
    helmet in one run are one track. So the order of the rows does not matter.

    Raises:
        InputError: naming file, row and reason.
    """
    path = Path(path)
    names, rows = read_table(path)
    missing = [name for name in TRACKLET_COLUMNS if name not in names]
    if missing:
        raise InputError(f"{path}: the header lacks {', '.join(missing)}")
    twice = [name for name in TRACKLET_COLUMNS if names.count(name) > 1]
    if twice:
        raise InputError(f"{path}: the header names {', '.join(twice)} twice")
    *places, helmet = (names.index(name) for name in TRACKLET_COLUMNS)
    numbers, codes, helmets = array("d"), array("q"), {}
    for at, fields in enumerate(rows, 1):
        numbers.extend(read_number(path, at, fields[place]) for place in places)
        codes.append(helmets.setdefault(fields[helmet], (len(helmets), at))[0])
    if not codes:
        raise InputError(f"{path}: the file has no rows")
    prefix = "Helmet_" * all(name.startswith("Helmet_") for name in helmets)
    people = People(path)
    first = [people.code(name.removeprefix(prefix), at) for name, (_, at) in helmets.items()]
    values = np.array(numbers).reshape(-1, len(places))
    ids = people.numbers(np.array(first)[np.array(codes)])
    rows = np.arange(1, len(ids) + 1)
    order = np.lexsort((values[:, 0], values[:, 3]))
    values, ids, rows = values[order], ids[order], rows[order]
    of = np.flatnonzero((np.diff(values[:, 3]) == 0) & (np.diff(ids) != 0))
    if len(of):
        tracklet = values[of[0], 3]
        raise InputError(f"{path}: row {rows[of[0] + 1]}: tracklet {tracklet:g} is of two helmets")
    again = np.flatnonzero((np.diff(values[:, 3]) == 0) & (np.diff(values[:, 0]) == 0))
    if len(again):
        at = max(rows[again[0]], rows[again[0] + 1])
        raise InputError(f"{path}: row {at} repeats a moment of tracklet {values[again[0], 3]:g}")

    runs = _runs(values[:, 3], ids, values[:, 0])
    name = printable(path.stem)
    return [
        assemble(path, values[at, 0], ids[at], values[at, 1:3], f"{name}_{run + 1}", row=rows[at])
        for run in range(runs[-1] + 1)
        for at in [runs == run]
    ]


def _runs(tracklet: np.ndarray, ids: np.ndarray, time: np.ndarray) -> np.ndarray:
    """[R] the number of each row's run, from 0; rows are in order of tracklet and time [R]."""
    begins = np.flatnonzero(np.diff(tracklet, prepend=np.nan) != 0)
    ends = np.append(begins[1:], len(ids)) - 1
    run, latest, runs = 0, {}, np.empty(len(ids), int)
    for begin, end in zip(begins.tolist(), ends.tolist()):
        agent = int(ids[begin])
        if time[begin] <= latest.get(agent, -np.inf):
            run, latest = run + 1, {}
        latest[agent] = time[end]
        runs[begin : end + 1] = run
    return runs


def read_cliff(path: Path) -> Tracks:
    """Tracks of CLiFF-LHMP: rows `time,id,x,y,speed,heading`, metres.

    Raises:
        InputError: naming file, row and reason.
    """
    path = Path(path)
    rows, ids = number_table(path, _CLIFF)
    refuse_unwhole(path, rows[:, 1], "id")
    return assemble(path, rows[:, 0], ids, rows[:, 2:4])


def _is_cliff(head: Head) -> bool:
    """Six numbers a row, the last two the speed and the heading, not a velocity's x and y."""
    if head.columns != len(_CLIFF):
        return False
    rows = head.rows
    speed, heading = rows[:, 4:].T
    before, after = consecutive(rows[:, 0], rows[:, 1])
    seconds = (rows[after, 0] - rows[before, 0])[:, None]
    known = ((seconds > 0) & (seconds < 2))[:, 0]  # Over longer gaps nobody goes straight.
    moved = ((rows[after] - rows[before])[:, 2:4] / np.where(seconds > 0, seconds, 1))[known]
    if not known.any() or speed.min() < 0 or np.abs(heading).max() > np.pi + 1e-3:
        return False
    polar = speed[:, None] * np.stack([np.cos(heading), np.sin(heading)], axis=1)

    def error(velocity: np.ndarray) -> float:
        # At a row stands the velocity of the step to it, or from it.
        return min(float(np.abs(velocity[at][known] - moved).sum()) for at in (before, after))

    return error(polar) < 0.4 * np.abs(moved).sum() and error(polar) < 0.5 * error(rows[:, 4:])


FORMATS = {
    "tracklets": Format(
        "THÖR-MAGNI tracklets",
        lambda head: set(TRACKLET_COLUMNS) <= {name.strip() for name in head.first.split(",")},
        lambda path, *_: read_tracklets(path),
    ),
    "cliff": Format(
        f"CLiFF-LHMP tracks (`{','.join(_CLIFF)}`)",
        _is_cliff,
        lambda path, *_: [read_cliff(path)],
    ),
}
