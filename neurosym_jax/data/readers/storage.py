"""Tables that are no text: dataframes and objects of other libraries, databases, columnar files.

None of these libraries is imported before an object or a file asks for it.
"""

import contextlib
import dataclasses
import importlib
import itertools
import json
import shlex
import sqlite3
import time
import zipfile
from collections import Counter
from collections.abc import Collection, Iterator, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
import polars as pl

from neurosym_jax.data.columns import facts_in, parse_columns
from neurosym_jax.data.readers.columns import SMOOTHER, Columns
from neurosym_jax.data.tables import (
    Head,
    Question,
    ReadOptions,
    Table,
    names_tracks,
    read_head,
    read_text_file,
    role_of,
)
from neurosym_jax.errors import InputError, brief, optional_module
from neurosym_jax.runtime.foreign import (
    read_array,
    read_arrays,
    reading,
    refuse_dense,
)

__all__ = ["FRAME", "InMemory", "Json", "Storage", "is_frame"]

LONGEST, CHECKED = 1_000_000, 100_000
"""Bytes of a field of a database, and rows between two checks of its size."""
SECONDS, RATE = 20, 1e6
"""Seconds that reading a database may take, and bytes of it for each further one."""
FRAME = Path("dataframe")  # what messages call one, and its recording
PICKLES = (b"\x80\x02", b"\x80\x03", b"\x80\x04", b"\x80\x05")
MAGIC = {
    **dict.fromkeys(PICKLES, "pickle"),
    b"\x93NUMPY": "npy",
    b"PK\x03\x04": "zip",
    b"MATLAB 5.0": "mat",
    b"SQLite format 3": "sqlite",
    b"\x89HDF": "hdf5",
    b"PAR1": "parquet",
    b"ARROW1": "arrow",
}


Content = tuple[Mapping[str, Any], Mapping[str, str]]
"""Columns [R] by name (series, arrays or lists), and the facts that a file says of them."""
NO_FACTS: Mapping[str, str] = MappingProxyType({})


class Storage(Columns):
    """SQLite, HDF5, Parquet, Arrow, arrays of numpy and MATLAB, sheets of Excel."""

    title = "table in a database or a columnar file"

    def knows(self, head: Head) -> bool:
        """By the first bytes."""
        return head.magic.startswith(tuple(MAGIC))

    def table(self, path: Path, options: ReadOptions) -> Table:
        """Its table of tracks, or the one that `table=NAME` says."""
        name = parse_columns(options.columns).get("table", "")
        return _table_in_storage(path, read_head(path).magic, name)


class Json(Columns):
    """JSON: rows, people with lists, COCO's boxes, or GeoJSON."""

    title = "rows in JSON"

    def knows(self, head: Head) -> bool:
        """By the first character, where no reader of another JSON knows it."""
        return head.lines[0][:1] in ("{", "[")

    def table(self, path: Path, options: ReadOptions) -> Table:
        """Its rows."""
        return _table_in_json(path)


@dataclasses.dataclass(frozen=True)
class InMemory(Columns):
    """A table that `is_frame`."""

    data: Any

    def table(self, path: Path, options: ReadOptions) -> Table:
        """The table itself."""
        return _table(path, *_content_of(self.data))


def is_frame(data: object) -> bool:
    """Whether `data` is a table of pandas, polars, pyarrow, GeoPandas, PedPy or MovingPandas, an
    array or a dictionary of columns."""
    if isinstance(data, type):
        return False
    if isinstance(data, np.ndarray | dict) or _is_pedpy(data) or _is_moving(data):
        return True
    # First what polars has, which warns of the other.
    has_columns = hasattr(data, "collect_schema") or hasattr(data, "columns")
    readers = ("itertuples", "iter_rows", "collect", "to_pydict")
    return has_columns and any(hasattr(data, name) for name in readers)


def _is_pedpy(data: Any) -> bool:
    return hasattr(data, "data") and hasattr(data, "frame_rate")


def _is_moving(data: Any) -> bool:
    return hasattr(data, "trajectories") or (
        hasattr(data, "df") and hasattr(data, "to_linestring")
    )


def _content_of(data: Any) -> Content:
    """The columns of an object that `is_frame`; named indices are columns.

    Raises:
        InputError: for columns of several lengths or of one name.
    """
    facts = NO_FACTS
    if isinstance(data, np.ndarray):
        return array_columns(data), facts
    if isinstance(data, dict):
        return _alike(data), facts
    if _is_pedpy(data):
        facts = {"fps": str(float(data.frame_rate))}
        data = data.data
    elif _is_moving(data):
        frames = (track.df for track in getattr(data, "trajectories", [data]))
        timed = [frame.rename_axis(index="t").reset_index() for frame in frames]
        data = importlib.import_module("pandas").concat(timed)
    if hasattr(data, "collect"):
        data = data.collect()
    if hasattr(data, "to_pydict"):
        data = pl.from_arrow(data)
    if hasattr(data, "itertuples"):
        return _columns_of_pandas(data), facts
    return _columns_of_polars(data), facts


def _alike(columns: Mapping[Any, Any]) -> dict[str, np.ndarray]:
    """Columns [R] by name as arrays.

    Raises:
        InputError: for columns of several lengths.
    """
    arrays = {str(name): np.asarray(values) for name, values in columns.items()}
    shapes = sorted({values.shape for values in arrays.values()})
    if len(shapes) != 1 or len(shapes[0]) != 1:
        raise InputError(
            f"columns of shapes {brief(shapes)}, not of one length: `make_tracks` takes "
            "arrays of stamps, ids and positions"
        )
    return arrays


def array_columns(array: np.ndarray) -> dict[str, np.ndarray]:
    """The columns of rows `frame id x y` [R, 4] or others [R, C], of fields, or of positions
    [T, N, 2] or [N, T, 2], NaN where nobody is.

    Time is the axis along which people go on. Positions of one point each are frames 0,
    1, ... of ids 0, 1, ...

    Raises:
        InputError: for another shape, and where both axes may be time.
    """
    if array.dtype.names:
        return {name: array[name] for name in array.dtype.names}
    if array.ndim == 2 and array.dtype.kind in "biuf":
        names = ("frame", "id", "x", "y")
        if array.shape[1] != 4:
            names = tuple(str(at + 1) for at in range(array.shape[1]))
        return dict(zip(names, array.T))
    if array.ndim != 3 or array.shape[2] != 2 or array.dtype.kind not in "biuf":
        raise InputError(
            f"{list(array.shape)} {array.dtype} is no recording: rows [R, 4] of frame, "
            "id, x, y, or positions [T, N, 2] are; `make_tracks` takes stamps, ids and positions"
        )
    first = _bend_along(array, 0)
    second = _bend_along(array, 1)
    if SMOOTHER * min(first, second) > max(first, second):
        raise InputError(
            f"positions {list(array.shape)}: which axis is time? `make_tracks` says it"
        )
    frame, person = np.indices(array.shape[:2]).reshape(2, -1)
    if first >= second:
        frame, person = person, frame
    x, y = array.reshape(-1, 2).T
    return {"frame": frame, "id": person, "x": x, "y": y}


def _bend_along(array: np.ndarray, axis: int) -> float:
    """The typical second difference along an axis; infinite where there is none."""
    bend = np.abs(np.diff(array, 2, axis=axis))
    bend = bend[np.isfinite(bend)]
    return np.median(bend) if len(bend) else np.inf


def _columns_of_pandas(frame: Any) -> dict[str, Any]:
    """The columns by name; points become x and y, durations seconds.

    Raises:
        InputError: for two columns of one name.
    """
    names = frame.index.names
    if any(name is not None and name not in frame.columns for name in names):
        frame = frame.reset_index()
    names = [str(name) for name in frame.columns]
    if len(set(names)) < len(names):
        raise InputError("two columns have one name")
    columns = {}
    for at, name in enumerate(names):
        column = frame.iloc[:, at]
        if str(column.dtype) == "geometry":
            columns |= {"x": column.values.x, "y": column.values.y}
        elif column.dtype.kind == "m":
            columns[name] = column.dt.total_seconds()
        else:
            columns[name] = column
    return columns


def _columns_of_polars(frame: pl.DataFrame) -> dict[str, Any]:
    """The columns by name; of structs those of their fields."""
    if any(dtype.is_nested() for dtype in frame.dtypes):
        return _columns_of_rows(list(map(_side_by_side, frame.to_dicts())))
    return frame.to_dict()


def _table(
    path: Path, columns: Mapping[str, Any], facts: Mapping[str, str] = NO_FACTS
) -> Table:
    """The table of columns [R] of values by name; its rows count from 0."""
    texts = [_texts(values) for values in columns.values()]
    rows = len(texts[0]) if texts else 0
    if not rows:
        raise InputError("has no rows")
    numbered = [values.alias(str(at)) for at, values in enumerate(texts)]
    fields = pl.DataFrame(numbered).select(pl.concat_list(pl.all())).to_series()
    return Table(path, list(columns), fields, np.arange(rows), facts=facts)


def _texts(values: Any) -> pl.Series:
    """Values as Python writes them; durations are seconds."""
    if isinstance(values, pl.Series):
        if isinstance(values.dtype, pl.Duration):
            values = values.dt.total_microseconds() / 1e6
        if values.dtype not in (pl.Categorical, pl.Binary, pl.Object):
            return values.cast(pl.String).fill_null("None")
    if isinstance(values, np.ndarray):
        values = values.tolist()
    return pl.Series([str(value) for value in values], dtype=pl.String)


def _table_in_storage(path: Path, magic: bytes, name: str) -> Table:
    """The table of tracks, called `name` if there are several.

    Raises:
        InputError: for a file that cannot be read, or has no table.
        Question: for one with several.
    """
    kind = ""
    for start, name_of_kind in MAGIC.items():
        if magic.startswith(start):
            kind = name_of_kind
    if kind == "pickle":
        code = "import pandas, sys; pandas.read_pickle(sys.argv[1]).to_csv(sys.argv[1] + '.csv')"
        raise InputError(
            "a pickle may run any code, so it is not read; if you trust it: "
            f'python -c "{code}" {shlex.quote(str(path))}'
        )
    read = {
        "npy": _in_npy,
        "zip": _in_zip,
        "mat": _in_mat,
        "sqlite": _in_sqlite,
        "hdf5": _in_hdf5,
    }
    with reading(path, kind):
        return _table(path, *read.get(kind, _in_columns)(path, name))


def _in_npy(path: Path, name: str) -> Content:
    return _alike(array_columns(read_array(path))), NO_FACTS


def _in_zip(path: Path, name: str) -> Content:
    """The first sheet of a workbook or the one called so, or the arrays of an `.npz`."""
    with zipfile.ZipFile(path) as archive:
        is_workbook = "xl/workbook.xml" in archive.namelist()
    if not is_workbook:
        return _in_arrays(read_arrays(path), name)
    optional_module("fastexcel", "a workbook", "excel")
    return _columns_of_polars(pl.read_excel(path, sheet_name=name or None)), NO_FACTS


def _in_mat(path: Path, name: str) -> Content:
    from scipy.io import loadmat

    arrays = {}
    for key, values in loadmat(path).items():
        if not key.startswith("_"):
            arrays[key] = np.squeeze(values)
    return _in_arrays(arrays, name)


def _in_arrays(arrays: Mapping[str, np.ndarray], name: str) -> Content:
    """The columns in one of several arrays, or that they are."""
    if names_tracks(list(arrays)):
        columns = {key: np.ravel(values) for key, values in arrays.items()}
    else:
        tables = [key for key, values in arrays.items() if values.ndim > 1]
        columns = array_columns(arrays[_the_one(tables, name)])
    return _alike(columns), NO_FACTS


def _the_one(names: Collection[str], name: str) -> str:
    """The table called `name`, or the only one."""
    if name in names:
        return name
    if len(names) == 1 and not name:
        (only,) = names
        return only
    answers = {(f"table={other}",): "" for other in list(names)[:8]}
    raise Question(
        f"has {len(names)} tables of tracks: {', '.join(names)[:200]}", answers
    )


def _in_columns(path: Path, name: str) -> Content:
    # Polars takes the descriptor, which a buffer of ours would have moved.
    with path.open("rb", buffering=0) as file:
        scan, read = pl.scan_ipc, pl.read_ipc
        if file.read(4) == b"PAR1":
            scan, read = pl.scan_parquet, pl.read_parquet
        file.seek(0)
        lazy = scan(file)
        rows = lazy.select(pl.len()).collect().item()
        refuse_dense(path, rows * len(lazy.collect_schema()))
        file.seek(0)
        return _columns_of_polars(read(file)), NO_FACTS


def _in_sqlite(path: Path, name: str) -> Content:
    """The one table whose columns name tracks; `metadata` has rows of key and value."""
    address = f"{path.absolute().as_uri()}?mode=ro"
    with contextlib.closing(sqlite3.connect(address, uri=True)) as base:
        _limit(base, path)
        heads = {}
        names = base.execute("select name from sqlite_master where type='table'")
        for (table,) in names.fetchall():
            columns = base.execute(f"pragma table_info({_quoted(table)})")
            heads[table] = [column[1] for column in columns]
        tracks = [table for table in heads if names_tracks(heads[table])]
        facts = {}
        for table, head in heads.items():
            if len(head) == 2:
                rows = base.execute(f"select * from {_quoted(table)}")
                facts |= facts_in(rows.fetchmany(1000))
        chosen = name if name in heads else _the_one(tracks, name)
        rows = []
        for row in base.execute(f"select * from {_quoted(chosen)}"):
            rows.append(row)
            # Pages of a damaged table may lead round in a circle.
            if len(rows) % CHECKED == 0:
                refuse_dense(path, len(rows) * len(row))
    if not rows:
        raise InputError(f"table {chosen} has no rows")
    return dict(zip(heads[chosen], zip(*rows))), facts


def _quoted(table: str) -> str:
    """The name of a table as SQL takes it."""
    name = table.replace('"', '""')
    return f'"{name}"'


def _limit(base: sqlite3.Connection, path: Path) -> None:
    """Let a database run nothing of its own, and hold no field of more than a megabyte."""
    base.execute("pragma trusted_schema = off")
    base.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, LONGEST)
    end = time.monotonic() + SECONDS + path.stat().st_size / RATE
    base.set_progress_handler(lambda: time.monotonic() > end, 1_000_000)


def _in_hdf5(path: Path, name: str) -> Content:
    """The data set called `name`, else `trajectory` or the only one, and its attribute fps."""
    h5py = optional_module("h5py", "HDF5", "hdf5")
    with h5py.File(path) as file:
        sets = {}
        for key, item in file.items():
            dtype = getattr(item, "dtype", None)
            if dtype is not None and (dtype.names or len(item.shape) > 1):
                sets[key] = item
        if not name and "trajectory" in sets:
            name = "trajectory"
        item = sets[_the_one(sets, name)]
        refuse_dense(path, item.size * len(item.dtype.names or " "))
        refuse_dense(path, item.nbytes / 8)
        facts = facts_in([*file.attrs.items(), *item.attrs.items()])
        return array_columns(item[()]), facts


def _table_in_json(path: Path) -> Table:
    """The rows of JSON: a list of objects, an object a line, or an object of columns.

    An object's lists are rows: a person may have `t`, `x` and `y`, or points of objects
    or of two numbers.

    Raises:
        InputError: for text that is no JSON, or no table.
    """
    content = _json_in(path)
    if isinstance(content, dict) and content.get("type") == "FeatureCollection":
        from neurosym_jax.data.readers.geojson import rows_of_features

        rows, notes = rows_of_features(content)
        table = _table(path, _columns_of_rows(rows))
        return dataclasses.replace(table, notes=tuple(notes))
    if isinstance(content, dict) and {"images", "annotations"} <= content.keys():
        content = _coco_rows(content)
    objects = content if isinstance(content, list) else _keyed(content)
    rows = list(itertools.chain(*map(_rows, objects)))
    return _table(path, _columns_of_rows(rows))


def _json_in(path: Path) -> Any:
    """The value in a file, or a list of those in its lines."""
    text = read_text_file(path)
    try:
        return json.loads(text)
    except (ValueError, RecursionError):
        pass
    try:
        return [json.loads(line) for line in text.split("\n") if line.strip()]
    except (ValueError, RecursionError) as error:
        raise InputError(f"no JSON ({str(error)[:60]})") from None


def _columns_of_rows(rows: Sequence[Mapping[str, Any]]) -> dict[str, list[Any]]:
    """The columns of rows of values by name, which need not have the same names."""
    columns = {}
    for name in dict.fromkeys(itertools.chain(*rows)):
        columns[name] = [row.get(name) for row in rows]
    return columns


def _coco_rows(content: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Boxes of COCO with the frame of their image and the name of their category."""
    frames, names = {}, {}
    for image in content["images"]:
        frame = image.get("frame_id", image.get("frame_index", image["id"]))
        frames[image["id"]] = frame
    for category in content.get("categories", []):
        names[category["id"]] = {"label": category["name"]}
    rows = []
    for box in content["annotations"]:
        row = {"frame": frames[box["image_id"]], "id": box.get("track_id", -1)}
        row |= zip(("left", "top", "width", "height"), box["bbox"], strict=True)
        rows.append(row | names.get(box.get("category_id"), {}))
    return rows


def _keyed(content: Any) -> list[Any]:
    """The objects of an object by key, with the key as the id or frame that they lack."""
    if not isinstance(content, dict):
        return [content]
    objects = []
    for name, value in content.items():
        for item in value if isinstance(value, list) else [value]:
            objects.append((name, item))
    if not all(isinstance(item, dict) for _, item in objects):
        return [content]
    names = {frozenset(item) for _, item in objects}
    roles = set(map(role_of, *names)) if len(names) == 1 else set()
    if not {"x", "y"} <= roles:
        return [content]
    if "id" not in roles:
        return [{"id": name, **item} for name, item in objects]
    if roles.isdisjoint({"time", "frame"}):
        return [{"frame": name, **item} for name, item in objects]
    return [item for _, item in objects]


def _rows(item: Any) -> Iterator[dict[str, Any]]:
    """The rows in an object: its lists side by side, with its other fields in each."""
    if not isinstance(item, dict):
        raise InputError(
            f"JSON of {type(item).__name__} {str(item)[:40]!r}, not of objects"
        )
    item = _side_by_side(item)
    lists = {key: value for key, value in item.items() if isinstance(value, list)}
    if not lists or _is_point(*lists.values()):
        yield item
        return
    if len(set(map(len, lists.values()))) > 1:
        raise InputError(f"lists of several lengths: {', '.join(lists)[:80]}")
    has_clock = not {"time", "frame"}.isdisjoint(map(role_of, item))
    axes = {}
    for key, points in lists.items():
        axes[key] = "txy" if not has_clock and _begin_with_times(points) else "xyz"
    for values in zip(*lists.values()):
        row = dict(item)
        for key, value in zip(lists, values):
            if isinstance(value, list) and len(value) in (2, 3):
                value = dict(zip(axes[key], value))
            row[key] = value
        yield from _rows(row)


def _begin_with_times(points: list[Any]) -> bool:
    """Whether points are of three numbers of which the first goes up."""
    triples = [point for point in points if isinstance(point, list) and len(point) == 3]
    firsts = [triple[0] for triple in triples]
    return len(triples) == len(points) and firsts == sorted(firsts)


def _is_point(first: list[Any], *others: list[Any]) -> bool:
    """Whether the lists of an object are one of two or three numbers."""
    are_numbers = all(isinstance(value, int | float) for value in first)
    return not others and len(first) in (2, 3) and are_numbers


def _side_by_side(item: Mapping[str, Any]) -> dict[str, Any]:
    """The fields of an object and of objects in it, as PART.NAME where a name stands twice."""
    parts = {
        key: _dotted(value) for key, value in item.items() if isinstance(value, dict)
    }
    fields = {key: value for key, value in item.items() if key not in parts}
    counts = Counter([*fields, *itertools.chain(*parts.values())])
    for key, part in parts.items():
        for name, value in part.items():
            fields[name if counts[name] == 1 else f"{key}.{name}"] = value
    return fields


def _dotted(item: Mapping[str, Any]) -> dict[str, Any]:
    """The fields of an object, and those of objects in it as PART.NAME."""
    fields = {}
    for key, value in item.items():
        if isinstance(value, dict):
            for name, inner in _dotted(value).items():
                fields[f"{key}.{name}"] = inner
        else:
            fields[key] = value
    return fields
