"""THÖR and THÖR-MAGNI, in the forms in which they are distributed.

- QTM exports (THÖR's 6D, THÖR-MAGNI): a header `Frame Time ...`, one row per frame,
millimetres.
- Tracklets of THÖR-MAGNI: `Time,...,x,y,...,ag_id,...,tracklet_id` in metres.

People wear helmets, whose numbers are their ids. Sources: A. Rudenko et al., "THÖR",
RA-L 5(2), 2020; T. Schreiter et al., "THÖR-MAGNI", IJRR 2024.
"""

import dataclasses
import itertools
import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from neurosym_jax.data.tables import Format, Head, ReadOptions, read_table
from neurosym_jax.data.tracks import Tracks
from neurosym_jax.errors import InputError, printable

__all__ = ["Qtm", "Tracklets"]

_TRACKLET = ("Time", "x", "y", "tracklet_id", "ag_id")
_HELMET = re.compile(r"Helmet_(\d{1,18})\s+(?:Centroid_)?X")


class Tracklets(Format):
    """Tracklets of THÖR-MAGNI."""

    title = "THÖR-MAGNI tracklets"
    uses = frozenset()

    def knows(self, head: Head) -> bool:
        """By five names of columns."""
        return set(_TRACKLET) <= set(head.names)

    def read(self, path: Path, options: ReadOptions, period: float) -> list[Tracks]:
        """The runs in a file: the next one begins where a helmet comes back at an earlier time.

        Raises:
            InputError: naming file, row and reason.
        """
        table = read_table(path)
        for name in _TRACKLET:
            if table.names.count(name) != 1:
                raise InputError(f"the header has not one {name}")
        *places, helmet = (table.names.index(name) for name in _TRACKLET)
        values = table.numbers(*places)
        ids, people = table.ids(helmet, prefix="Helmet_")
        order = np.lexsort((values[:, 0], values[:, 3]))
        time, x, y, tracklet = values[order].T
        table, ids = table.take(order), ids[order]

        run = 0
        latest = dict[int, float]()
        runs = np.zeros(len(ids), int)
        bounds = np.flatnonzero(np.diff(tracklet, prepend=np.nan)).tolist()
        for begin, end in itertools.pairwise([*bounds, len(ids)]):
            if time[begin] <= latest.get(ids[begin], -np.inf):
                run += 1
                latest = {}
            latest[ids[begin]] = time[end - 1]
            runs[begin:end] = run
        names = [f"{printable(path.stem)}_{number + 1}" for number in range(run + 1)]
        return table.tracks(
            time,
            ids,
            np.column_stack([x, y]),
            parts=(names, runs),
            people=people,
        )


class Qtm(Format):
    """Motion capture of THÖR and THÖR-MAGNI."""

    title = "QTM export (THÖR, THÖR-MAGNI)"
    uses = frozenset()

    def knows(self, head: Head) -> bool:
        """A header that begins with `Frame` and names a helmet."""
        for line in head.lines:
            if re.match("Frame[\t,]", line) and "Helmet" in line:
                return True
        return False

    def read(self, path: Path, options: ReadOptions, period: float) -> list[Tracks]:
        """The people with helmets, where their coordinates are not all zero, and none is empty.

        Raises:
            InputError: naming file, row and reason.
        """
        table = read_table(path, header=r"Frame[\t,]")
        places = _helmets(table.names)
        if not places or "Time" not in table.names:
            raise InputError(
                "the header names no Time, or no `Helmet_1 X` (or centroids)"
            )
        stamp = table.numbers(table.names.index("Time"))[:, 0]
        columns = []
        for at in places.values():
            columns += [at, at + 1, at + 2]
        millimetres = table.numbers(*columns, missing=True)
        points = millimetres.reshape(len(stamp), len(places), 3) / 1000
        is_empty = np.isnan(points).any(axis=-1)
        is_zero = (points == 0).all(axis=-1)
        frame, body = np.nonzero(~is_empty & ~is_zero)
        if not len(frame):
            raise InputError(f"none of its {len(places)} helmets is ever visible")
        ids = np.array(list(places))[body]
        position = points[frame, body, :2]
        # Only the numbers of the rows: a row is as wide as all helmets.
        table = dataclasses.replace(table, row=table.row[frame])
        return table.tracks(stamp[frame], ids, position)


def _helmets(names: Sequence[str]) -> dict[int, int]:
    """Column X of each helmet, or of its centroid where there are markers too; Y and Z follow.

    Raises:
        InputError: for a helmet that is named twice, and where Y and Z do not follow.
    """
    places = dict[int, int]()
    for column, name in enumerate(names):
        match = _HELMET.fullmatch(name)
        if not match:
            continue
        helmet = int(match[1])
        if helmet in places:
            raise InputError(f"the header names {name} twice")
        places[helmet] = column
        # In 6D exports only X carries the helmet's name.
        axes = [other[-1:] for other in names[column : column + 3]]
        if axes != ["X", "Y", "Z"]:
            raise InputError(f"Y and Z do not follow {name}")
    return places
