"""The track table: where each agent was at each time, between the readers and the windows.

The table keeps the recording's own clock in seconds and its own world frame in metres.
"""

import dataclasses
from collections.abc import Iterable, Mapping, Sequence
from types import MappingProxyType
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import ArrayLike

from neurosym_jax.errors import InputError, option, printable, refuse_masked

__all__ = ["GAP", "LATE", "PERIOD", "SNAP", "Reading", "Tracks", "describe_readings"]
__all__ += ["common", "fields_at", "make_tracks"]

# seconds between the steps of the ETH/UCY benchmark and of every shipped model
PERIOD = 0.4
SNAP = 1e-6  # seconds within which a stamp counts as a grid point: clocks are rounded
GAP = 1.5  # a step of a person longer than this many usual ones is a gap
LATE = 1e11  # latest time accepted, seconds; a float64 of this size resolves 20 microseconds
MAX_METRES = 1e8  # largest coordinate accepted; UTM and web maps stay below


@dataclasses.dataclass(frozen=True)
class Reading:
    """How a recording was read; people, model cards and JSON reports show it."""

    recording: str
    file: str | None = None  # path, if there is a file
    format: str | None = None  # name of the file's format
    rows: int = 0  # points that were read
    filled: int = 0  # points that were interpolated in gaps of single people's tracks
    # points of windows, once cut, that lie between two points of the file
    interpolated: int = 0
    gaps: int = 0  # gaps in time, once windows are cut; windows do not cross them
    warnings: tuple[str, ...] = ()  # what looks wrong, a line each
    notes: tuple[str, ...] = ()
    """What the file said of itself, and what was guessed, a line each."""
    rate: float | None = None  # frame numbers a second, where the file numbers frames
    columns: tuple[str, ...] = ()  # a table's, ROLE=COLUMN each, named or guessed
    unused: tuple[str, ...] = ()  # names of a table's other columns
    left_out: tuple[str, ...] = ()  # how many rows were not read and why, a line each

    def __str__(self) -> str:
        """A line: format, rows, what is left out, gaps, interpolated points and notes."""
        parts = [f"{self.rows} rows"]
        parts += [f"{line} left out" for line in self.left_out]
        if self.interpolated:
            parts.append(f"{self.interpolated} points of windows interpolated")
        if self.filled:
            parts.append(f"{self.filled} points filled in gaps")
        if self.gaps:
            parts.append(f"{self.gaps} gaps in time")
        line = f"read {self.recording}: {self.format}, {', '.join(parts)}"
        if self.unused:
            names = ", ".join(name[:20] for name in self.unused[:8])
            line += f"; columns not used: {names}"
        return printable("; ".join([line, *self.notes]))


@dataclasses.dataclass(frozen=True, eq=False)
class Tracks:
    """The points of one recording: R rows sorted by (id, stamp). Build with `make_tracks`."""

    recording: str  # name, used in messages and in the identity of its scenes
    stamp: np.ndarray  # [R] float64 seconds on the recording's clock
    id: np.ndarray  # [R] int64 agent
    position: np.ndarray  # [R, 2] float64 metres in the recording's frame
    extras: Mapping[str, np.ndarray] = dataclasses.field(default_factory=dict)
    """name: [R, ...] further numbers of each row, as a group, a class or a heading."""
    # [R] seconds: last observation that the point depends on
    known: np.ndarray | None = None
    # [R, 2] metres: extrapolated from those before `known`
    foreseen: np.ndarray | None = None
    # seconds between points of the grids that all stamps lie on
    period: float | None = None
    # [R] int64 number on that grid; pieces of other phase are apart
    step: np.ndarray | None = None
    reading: Reading | None = None  # how the recording was read from a file
    names: tuple[str, ...] = ()  # texts of the ids 0, 1, ... where ids are texts
    _columns: ClassVar = ("stamp", "id", "position", "known", "foreseen", "step")

    def take(self, rows: np.ndarray | slice) -> Self:
        """Select rows ([R] bool mask, [R'] ascending indices, or a slice) with all their fields."""
        extras = {name: values[rows] for name, values in self.extras.items()}
        return dataclasses.replace(
            self, extras=extras, **fields_at(self, self._columns, rows)
        )

    def with_ids(self, id: np.ndarray) -> Self:
        """The same points with other ids [R] int64, sorted by them."""
        order = _order(self.recording, self.stamp, id)
        # Fresh ids have no name.
        names = self.names if np.all(id < len(self.names)) else ()
        return dataclasses.replace(self, id=id, names=names).take(order)

    def ids_as_given(self, rows: np.ndarray | slice = slice(None)) -> np.ndarray:
        """[R'] ids of rows as the file has them: whole numbers or texts."""
        if self.names:
            return np.array(self.names)[self.id[rows]]
        return self.id[rows]


def fields_at(data: Any, names: Iterable[str], rows: Any) -> dict[str, np.ndarray]:
    """The arrays of some names that `data` has, at `rows`."""
    arrays = {}
    for name in names:
        values = getattr(data, name)
        if values is not None:
            arrays[name] = values[rows]
    return arrays


def make_tracks(
    recording: str,
    stamp: ArrayLike,
    id: ArrayLike,
    position: ArrayLike,
    extras: Mapping[str, ArrayLike] = MappingProxyType({}),
    *,
    reading: Reading | None = None,
    row: np.ndarray | None = None,
) -> Tracks:
    """Check, copy and sort rows given in any order.

    They have `stamp` [R] seconds, `id` [R] whole numbers or texts, `position` [R, 2]
    metres, and `extras` name: [R, ...] numbers. Messages call them `row` [R] (default: from 0) of
    the file in `reading`.

    Raises:
        InputError: naming the recording, the first wrong row and the reason.
    """
    file = reading.file if reading and reading.file else recording
    refuse_masked({"stamp": stamp, "id": id, "position": position, **extras})
    times = np.asarray(stamp, np.float64)
    points = np.asarray(position, np.float64)
    ids = np.asarray(id)
    names: tuple[str, ...] = ()
    if ids.dtype.kind in "UO" and all(isinstance(text, str) for text in ids.flat):
        texts, ids = np.unique(ids, return_inverse=True)
        names = tuple(texts.tolist())
    others = {name: np.asarray(values) for name, values in extras.items()}
    _refuse_shapes(file, {"stamp": times, "id": ids, "position": points, **others})

    is_usable = np.abs(times) <= LATE
    hint = f" of seconds ({option('time_unit')}?)"
    _refuse_values(file, row, "time", times, is_usable, hint)
    is_usable = (np.abs(points) <= MAX_METRES).all(axis=1)
    _refuse_values(file, row, "position", points, is_usable)
    is_usable = ids <= np.iinfo(np.int64).max
    if ids.dtype.kind == "f":
        # Above 2**53 neighbouring ids share one float.
        is_usable &= (np.abs(ids) <= 2.0**53) & (ids == np.rint(ids))
    _refuse_values(file, row, "id", ids, is_usable)
    ids = ids.astype(np.int64)
    tracks = Tracks(recording, times, ids, points, others, reading=reading, names=names)
    unused = reading.unused if reading else ()
    return tracks.take(_order(file, times, ids, row, names, unused))


def _refuse_shapes(file: str, arrays: Mapping[str, np.ndarray]) -> None:
    """Refuse arrays that are not numbers of the same R > 0 rows."""
    rows = arrays["stamp"].size
    shapes = {"stamp": (rows,), "id": (rows,), "position": (rows, 2)}
    for name, array in arrays.items():
        shape = shapes.get(name, (rows, *array.shape[1:]))
        if not rows or array.shape != shape or array.dtype.kind not in "biuf":
            kind = f"{list(array.shape)} {array.dtype}"
            raise InputError(
                f"{file}: {name} must be numbers {list(shape)}, not {kind}"
            )


def _refuse_values(
    file: str,
    row: np.ndarray | None,
    name: str,
    values: np.ndarray,
    is_usable: Any,
    hint: str = "",
) -> None:
    """Refuse the first of [R] values that is not usable by the mask `is_usable` [R]."""
    if not np.all(is_usable):
        at = int(np.argmin(is_usable))
        line = at if row is None else row[at]
        value = f"{name} {values[at]}"
        raise InputError(f"{file}: row {line}: {value} is not a usable number{hint}")


def _order(
    file: str,
    stamp: np.ndarray,
    id: np.ndarray,
    row: Any = None,
    names: Sequence[str] = (),
    unused: Sequence[str] = (),
) -> np.ndarray:
    """[R] indices that sort the rows by (id, stamp); messages name `unused` columns of the file."""
    order = np.lexsort((stamp, id))
    same_agent = np.diff(id[order]) == 0
    same_stamp = np.diff(stamp[order]) == 0
    repeats = order[1:][same_agent & same_stamp]
    if len(repeats):
        at = repeats[0]
        line = at if row is None else row[at]
        person = names[int(id[at])][:40] if names else id[at]
        message = f"{file}: row {line}: repeats agent {person} at {stamp[at]:.12g} s"
        if unused:
            recordings = option("columns", (f"recording={unused[0]}",))
            columns = ", ".join(unused[:4])
            message += f" (unused columns: {columns}; {recordings}, if one tells recordings apart)"
        raise InputError(message)
    return order


def common(values: np.ndarray) -> float:
    """The most common of [R] numbers, R > 0; the smallest of several."""
    kinds, counts = np.unique(values, return_counts=True)
    return float(kinds[np.argmax(counts)])


def describe_readings(readings: Iterable[Reading]) -> str:
    """A line for each recording that was read from a file."""
    latest = {(reading.file, reading.recording): reading for reading in readings}
    return "\n".join(str(reading) for reading in latest.values() if reading.file)
