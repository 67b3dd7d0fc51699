"""Tables that are no text: dataframes and objects of other libraries, databases, columnar files.

None of these libraries is imported before an object or a file asks for it.
"""

import contextlib
import importlib
import json
import sqlite3
import time
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
import polars as pl

from neurosym_jax.data.columns import RATE_NAMES, names_tracks, plain_name
from neurosym_jax.data.readers.columns import Columns
from neurosym_jax.data.tables import Head, ReadOptions, Table, read_head, read_text_file
from neurosym_jax.data.tracks import Tracks
from neurosym_jax.errors import InputError, optional_module
from neurosym_jax.runtime.foreign import reading, refuse_dense

__all__ = ["FRAME", "Json", "Storage", "is_frame", "table_of"]

LONGEST, CHECKED = 1_000_000, 100_000
"""Bytes of a field of a database, and rows between two checks of its size."""
SECONDS, RATE = 20, 1e6
"""Seconds that reading a database may take, and bytes of it for each further one."""
FRAME = Path("dataframe")  # what messages call one, and its recording
MAGIC = {
    b"SQLite format 3": "sqlite",
    b"\x89HDF": "hdf5",
    b"PAR1": "parquet",
    b"ARROW1": "arrow",
}


class Storage(Columns):
    """SQLite, HDF5, Parquet or Arrow."""

    title = "table in a database or a columnar file"

    def knows(self, head: Head) -> bool:
        """By the first bytes."""
        return head.magic.startswith(tuple(MAGIC))

    def read(self, path: Path, options: ReadOptions, period: float) -> list[Tracks]:
        """The recordings in its table of tracks."""
        return self.take(
            _table_in_storage(path, read_head(path).magic), options, period
        )


class Json(Columns):
    """JSON: rows, or people with lists."""

    title = "rows in JSON"

    def knows(self, head: Head) -> bool:
        """By the first character, where no reader of another JSON knows it."""
        return head.lines[0][:1] in ("{", "[")

    def read(self, path: Path, options: ReadOptions, period: float) -> list[Tracks]:
        """The recordings in its rows."""
        return self.take(_table_in_json(path), options, period)


def is_frame(data: object) -> bool:
    """Whether `data` is a table of pandas, polars, pyarrow, GeoPandas, PedPy or MovingPandas."""
    if isinstance(data, type):
        return False
    framed = hasattr(data, "collect_schema") or hasattr(
        data, "columns"
    )  # Polars warns of it.
    rows = any(
        hasattr(data, name)
        for name in ("itertuples", "iter_rows", "collect", "to_pydict")
    )
    return (framed and rows) or _is_pedpy(data) or _is_moving(data)


def _is_pedpy(data: Any) -> bool:
    return hasattr(data, "data") and hasattr(data, "frame_rate")


def _is_moving(data: Any) -> bool:
    return hasattr(data, "trajectories") or (
        hasattr(data, "df") and hasattr(data, "to_linestring")
    )


def table_of(data: Any) -> Table:
    """The table in an object that `is_frame`; its rows count from 0, and named indices are columns.

    Raises:
        InputError: for an empty one.
    """
    facts: dict[str, str] = {}
    if _is_pedpy(data):
        facts, data = {"fps": str(float(data.frame_rate))}, data.data
    elif _is_moving(data):
        frames = (track.df for track in getattr(data, "trajectories", [data]))
        timed = [frame.rename_axis(index="t").reset_index() for frame in frames]
        data = importlib.import_module("pandas").concat(timed)
    if hasattr(data, "collect"):
        data = data.collect()
    if hasattr(data, "to_pydict"):
        data = pl.from_arrow(data)
    if hasattr(data, "itertuples"):
        if any(
            name is not None and name not in data.columns for name in data.index.names
        ):
            data = data.reset_index()
        columns = {str(name): data.iloc[:, at] for at, name in enumerate(data.columns)}
        if len(columns) < len(data.columns):
            raise InputError(f"{FRAME}: two columns have one name")
        columns = dict(_columns_of_pandas(columns))
    else:
        columns = {name: _texts(data[name]) for name in data.columns}
    return _table(FRAME, columns, facts)


def _columns_of_pandas(columns: Mapping[str, Any]) -> Any:
    """Name and texts of each column; points become x and y, durations seconds."""
    for name, column in columns.items():
        if str(column.dtype) == "geometry":
            points = column.values
            yield "x", pl.Series(list(map(str, points.x)))
            yield "y", pl.Series(list(map(str, points.y)))
        elif column.dtype.kind == "m":
            yield name, pl.Series(list(map(str, column.dt.total_seconds())))
        else:
            yield name, pl.Series(list(map(str, column)), dtype=pl.String)


def _texts(column: pl.Series) -> pl.Series:
    """A column as text; durations are seconds."""
    if isinstance(column.dtype, pl.Duration):
        column = column.dt.total_microseconds() / 1e6
    if column.dtype.is_nested() or column.dtype in (
        pl.Categorical,
        pl.Binary,
        pl.Object,
    ):
        return pl.Series(list(map(str, column)), dtype=pl.String)
    return column.cast(pl.String).fill_null("None")


def _table(
    path: Path,
    columns: Mapping[str, pl.Series],
    facts: Mapping[str, str] = MappingProxyType({}),
) -> Table:
    rows = len(next(iter(columns.values()), []))
    if not rows:
        raise InputError(f"{path}: has no rows")
    plain = [texts.alias(str(at)) for at, texts in enumerate(columns.values())]
    fields = pl.DataFrame(plain).select(pl.concat_list(pl.all())).to_series()
    return Table(path, list(columns), fields, np.arange(rows), facts=facts)


def _table_in_storage(path: Path, magic: bytes) -> Table:
    """The table of tracks in a database, an HDF5 file of Jülich or a columnar file.

    Raises:
        InputError: for a file that cannot be read, or has no table, or several.
    """
    kind = next((kind for start, kind in MAGIC.items() if magic.startswith(start)), "")
    read = {"sqlite": _in_sqlite, "hdf5": _in_hdf5}.get(kind, _in_columns)
    with reading(path, kind):
        columns, facts = read(path)
    return _table(path, columns, facts)


def _in_columns(path: Path) -> tuple[dict[str, pl.Series], dict[str, str]]:
    with path.open("rb") as file:
        is_parquet = file.peek(4)[:4] == b"PAR1"
        lazy = (pl.scan_parquet if is_parquet else pl.scan_ipc)(file)
        rows = lazy.select(pl.len()).collect().item()
        refuse_dense(path, rows * len(lazy.collect_schema()))
        file.seek(0)
        frame = (pl.read_parquet if is_parquet else pl.read_ipc)(file)
    return {name: _texts(frame[name]) for name in frame.columns}, {}


def _in_sqlite(path: Path) -> tuple[dict[str, pl.Series], dict[str, str]]:
    """The one table whose columns name tracks; `metadata` has rows of key and value."""
    with contextlib.closing(
        sqlite3.connect(f"{path.absolute().as_uri()}?mode=ro", uri=True)
    ) as base:
        _limit(base, path)
        names = [
            name
            for (name,) in base.execute(
                "select name from sqlite_master where type='table'"
            )
        ]
        quoted = {name: '"' + name.replace('"', '""') + '"' for name in names}
        heads = {
            name: [
                column[1]
                for column in base.execute(f"pragma table_info({quoted[name]})")
            ]
            for name in names
        }
        tracks = [name for name in names if names_tracks(heads[name])]
        if len(tracks) != 1:
            tables = ", ".join(
                f"{name} ({' '.join(head)})" for name, head in heads.items()
            )
            raise InputError(
                f"{path}: has {len(tracks)} tables of tracks among {tables[:200]}"
            )
        facts = {}
        for name in names:
            if len(heads[name]) == 2:
                rows = base.execute(f"select * from {quoted[name]}").fetchmany(1000)
                rates = [
                    value
                    for key, value in rows
                    if plain_name(str(key))[0] in RATE_NAMES
                ]
                facts |= {"fps": str(float(rates[0]))} if rates else {}
        rows = []
        for row in base.execute(f"select * from {quoted[tracks[0]]}"):
            rows.append(row)
            # Pages of a damaged table may lead round in a circle.
            if len(rows) % CHECKED == 0:
                refuse_dense(path, len(rows) * len(row))
    columns = zip(
        heads[tracks[0]], zip(*rows) if rows else [[]] * len(heads[tracks[0]])
    )
    return {name: pl.Series(list(map(str, values))) for name, values in columns}, facts


def _limit(base: sqlite3.Connection, path: Path) -> None:
    """Let a database run nothing of its own, and hold no field of more than a megabyte."""
    base.execute("pragma trusted_schema = off")
    base.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, LONGEST)
    end = time.monotonic() + SECONDS + path.stat().st_size / RATE
    base.set_progress_handler(lambda: time.monotonic() > end, 1_000_000)


def _in_hdf5(path: Path) -> tuple[dict[str, pl.Series], dict[str, str]]:
    """The data set `trajectory`, or the only one with named fields, and its attribute fps."""
    h5py = optional_module("h5py", f"{path}: HDF5", "hdf5")
    with h5py.File(path) as file:
        sets = {
            name: item
            for name, item in file.items()
            if getattr(item, "dtype", None) is not None
        }
        sets = {name: item for name, item in sets.items() if item.dtype.names}
        if len(sets) != 1 and "trajectory" not in sets:
            raise InputError(
                f"{path}: has {len(sets)} data sets with named fields, not one"
            )
        item = sets.get("trajectory") or next(iter(sets.values()))
        refuse_dense(path, item.size * len(item.dtype.names))
        refuse_dense(path, item.nbytes / 8)
        attributes = {**file.attrs, **item.attrs}
        facts = {"fps": str(float(attributes["fps"]))} if "fps" in attributes else {}
        values = item[()]
    return {
        name: pl.Series(list(map(str, values[name].tolist())))
        for name in values.dtype.names
    }, facts


def _table_in_json(path: Path) -> Table:
    """The rows of JSON: a list of objects, an object a line, or an object of columns.

    An object's lists are rows: a person may have `t`, `x` and `y`, or points of objects
    or of two numbers.

    Raises:
        InputError: for text that is no JSON, or no table.
    """
    text = read_text_file(path)
    try:
        content = json.loads(text)
    except (ValueError, RecursionError):
        try:
            content = [json.loads(line) for line in text.split("\n") if line.strip()]
        except (ValueError, RecursionError) as error:
            raise InputError(f"{path}: no JSON ({str(error)[:60]})") from None
    objects = content if isinstance(content, list) else [content]
    if len(objects) == 1 and isinstance(objects[0], dict):
        inner = [value for value in objects[0].values() if isinstance(value, list)]
        if len(inner) == 1 and inner[0] and isinstance(inner[0][0], dict):
            objects = inner[0]  # An object around a list of people or rows.
    rows = [row for item in objects for row in _rows(path, item)]
    names = list(dict.fromkeys(name for row in rows for name in row))
    return _table(
        path, {name: pl.Series([str(row.get(name)) for row in rows]) for name in names}
    )


def _rows(path: Path, item: Any) -> list[dict[str, Any]]:
    """The rows in an object: its lists side by side, with its other fields in each."""
    if not isinstance(item, dict):
        raise InputError(
            f"{path}: JSON of {type(item).__name__} {str(item)[:40]!r}, not of objects"
        )
    plain = {key: value for key, value in item.items() if not isinstance(value, dict)}
    if len(plain) < len(item):
        item = _side_by_side(
            [(key, item[key]) for key in item if key not in plain], plain
        )
    lists = {key: value for key, value in item.items() if isinstance(value, list)}
    others = {key: value for key, value in item.items() if key not in lists}
    if not lists:
        return [others]
    if len({len(value) for value in lists.values()}) > 1:
        raise InputError(f"{path}: lists of several lengths: {', '.join(lists)[:80]}")
    rows = []
    for values in zip(*lists.values()):
        parts = []
        for key, value in zip(lists, values):
            if isinstance(value, list) and len(value) in (2, 3):
                names = ("x", "y") if len(value) == 2 else ("t", "x", "y")
                value = dict(zip(names, value))
            parts.append((key, value if isinstance(value, dict) else {key: value}))
        rows.append(others | _side_by_side(parts))
    return rows


def _side_by_side(
    parts: Sequence[tuple[str, dict[str, Any]]],
    plain: Mapping[str, Any] = MappingProxyType({}),
) -> dict[str, Any]:
    """The fields `plain` and those of named parts, as PART.NAME where a name stands twice."""
    counts = Counter([*plain, *(name for _, part in parts for name in part)])
    return dict(plain) | {
        name if counts[name] == 1 else f"{key}.{name}": value
        for key, part in parts
        for name, value in part.items()
    }
