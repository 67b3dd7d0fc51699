"""Tracks made of THÖR and THÖR-MAGNI, in the forms in which they are distributed.

- Tracklets of THÖR-MAGNI: `Time,...,x,y,...,ag_id,...,tracklet_id` in metres.
- Tracks of CLiFF-LHMP: `time,id,x,y,speed,heading` in metres, no header. Every agent has a clock of
  its own, so `tracks.resample` must bring them to one grid before they are a scene.

Nothing is smoothed or filled in. Sources: T. Schreiter et al., "THÖR-MAGNI", IJRR 2024; Y. Zhu et
al., "CLiFF-LHMP", IROS 2023.
"""

from pathlib import Path

import numpy as np

from neurosym_jax.data.rows import assemble
from neurosym_jax.data.tables import read_table
from neurosym_jax.data.text import recording_name
from neurosym_jax.data.tracks import Tracks
from neurosym_jax.errors import InputError

__all__ = ["TRACKLET_COLUMNS", "read_cliff", "read_tracklets"]

TRACKLET_COLUMNS = ("Time", "x", "y", "tracklet_id", "ag_id")


def read_tracklets(path: Path, *_: object) -> list[Tracks]:
    """The runs in a file of THÖR-MAGNI tracklets.

    A tracklet is a part of the way of one helmet in one run. Tracklets are numbered run by run;
    nothing else tells the runs apart: the next run begins where a helmet comes back at an earlier
    time. Tracklets of a helmet in one run are one track. The order of the rows does not matter.

    Raises:
        InputError: naming file, row and reason.
    """
    table = read_table(path)
    for name in TRACKLET_COLUMNS:
        if table.names.count(name) != 1:
            times = "lacks" if name not in table.names else "repeats"
            raise InputError(f"{path}: the header {times} {name}")
    *places, helmet = (table.names.index(name) for name in TRACKLET_COLUMNS)
    values, ids = table.numbers(*places), table.ids(helmet, prefix="Helmet_")
    rows = np.arange(1, len(ids) + 1)
    order = np.lexsort((values[:, 0], values[:, 3]))
    values, ids, rows = values[order], ids[order], rows[order]
    same = np.diff(values[:, 3]) == 0
    for wrong, reason in (
        (same & (np.diff(ids) != 0), "tracklet {:g} is of two helmets"),
        (same & (np.diff(values[:, 0]) == 0), "repeats a moment of tracklet {:g}"),
    ):
        if wrong.any():
            at = int(np.argmax(wrong))
            row = max(rows[at], rows[at + 1])
            raise InputError(f"{path}: row {row}: {reason.format(values[at, 3])}")
    runs = _runs(values[:, 3], ids, values[:, 0])
    return [
        assemble(
            path,
            values[at, 0],
            ids[at],
            values[at, 1:3],
            recording=f"{recording_name(path)}_{run + 1}",
            row=rows[at],
        )
        for run in range(runs[-1] + 1)
        for at in [runs == run]
    ]


def _runs(tracklet: np.ndarray, ids: np.ndarray, time: np.ndarray) -> np.ndarray:
    """[R] number of the run, from 0, of rows in order of (tracklet, time)."""
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


def read_cliff(path: Path, *_: object) -> Tracks:
    """Tracks of CLiFF-LHMP: rows `time,id,x,y,speed,heading`, metres.

    Raises:
        InputError: naming file, row and reason.
    """
    table = read_table(path, ("time", "id", "x", "y", "speed", "heading"))
    table.whole_numbers(1)
    values = table.numbers(0, 2, 3, 4, 5)
    return assemble(table.path, values[:, 0], table.ids(1), values[:, 1:3])
