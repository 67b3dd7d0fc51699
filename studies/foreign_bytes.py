"""Damaged files of every kind through every reader: each is read, or refused in one line.

    python -m studies.foreign_bytes [--count 500] [--seed 0] [--kind NAME ...]

makes a good file of each kind, changes it `count` times and reads it. A third of the
changes are bytes anywhere; the others know the structure: a number or a word of a text,
an array's shape, type or values, a column's type. It prints for each kind how many were
read and refused, what was raised else (with the case, which the seed repeats), the
longest time, and the most memory that a file took (Linux).
"""

import argparse
import io
import json
import re
import resource
import sqlite3
import sys
import tempfile
import time
import traceback
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl

from neurosym_jax.commands._options import with_file
from neurosym_jax.commands.train import Options
from neurosym_jax.data.columns import read_homography
from neurosym_jax.data.recordings import read_any
from neurosym_jax.errors import InputError
from neurosym_jax.evaluation.compare import FORMAT, read_report
from neurosym_jax.evaluation.forecasts import read_forecasts, windows_of
from neurosym_jax.interop.parity import run_parity
from neurosym_robot.dashboard.moments import read_floor_map

__all__ = ["KINDS", "damage", "main", "try_case"]

Rng = np.random.Generator
WORDS = (
    *("0", "-1", "1e308", "nan", "inf", "-0.0", "1e-320", "9" * 25, "0x10", "1,5"),
    *(
        "",
        '""',
        "[]",
        "{}",
        "null",
        "true",
        "#",
        "\x00",
        "é",
        "frame",
        "id",
        "fps",
        "=",
    ),
)
"""What takes the place of a number or a word."""
SHAPES = ((), (0,), (1,), (2, 2), (0, 3), (1, 1, 1, 1, 1), (2**31,))
TYPES = ("f8", "f4", "f2", "i8", "u1", "b1", "c16", "U3", "S2", "M8[s]", "m8[s]")
TOKEN = re.compile(r"[-+\w.]+")


def walk(steps: int = 30, people: int = 4) -> list[tuple[int, int, float, float]]:
    """Rows frame, id, x, y of people who walk side by side."""
    return [
        (10 * step, person, 0.4 * step + person, 0.9 * person)
        for step in range(steps)
        for person in range(people)
    ]


def frame() -> pl.DataFrame:
    """The rows as a table."""
    return pl.DataFrame(walk(), schema=["frame", "id", "x", "y"], orient="row")


def text_of_walk(head: str = "frame,id,x,y") -> str:
    """The rows as CSV, with a comment."""
    lines = [",".join(map(str, row)) for row in walk()]
    return "\n".join(["# frame rate: 25", head, *lines])


def with_word(text: str, rng: Rng) -> str:
    """The text with another word, or a part of it twice or not at all."""
    places = list(TOKEN.finditer(text))
    place = places[rng.integers(len(places))]
    word = WORDS[rng.integers(len(WORDS))]
    kind = rng.integers(4)
    if kind < 2:
        return text[: place.start()] + word + text[place.end() :]
    start, end = np.sort(rng.integers(0, len(text), 2))
    if kind == 2:
        return text[:start] + text[end:]
    return text[:end] + text[start:]


def with_bytes(content: bytes, rng: Rng) -> bytes:
    """The content with a few other bytes, or cut short."""
    if rng.random() < 0.2:
        return content[: rng.integers(len(content))]
    changed = bytearray(content)
    for _ in range(rng.integers(1, 5)):
        changed[rng.integers(len(changed))] = rng.integers(256)
    return bytes(changed)


def text(content: str, suffix: str) -> Callable[[Path, Rng], Path]:
    """Damage of a file of text."""

    def write(folder: Path, rng: Rng) -> Path:
        path = folder / f"a{suffix}"
        if rng.random() < 1 / 3:
            path.write_bytes(with_bytes(content.encode(), rng))
        else:
            damaged = with_word(content, rng)
            path.write_text(damaged, encoding="utf-8")
        return path

    return write


def with_array(arrays: dict[str, Any], rng: Rng) -> dict[str, Any]:
    """The arrays, one of which has another shape, type or value, or is absent."""
    name = sorted(arrays)[rng.integers(len(arrays))]
    array, kind = np.asarray(arrays[name]), rng.integers(5)
    if kind == 0:
        return {key: value for key, value in arrays.items() if key != name}
    if kind == 1:
        shape = SHAPES[rng.integers(len(SHAPES) - 1)]
        changed = np.resize(array, shape)
    elif kind == 2:
        changed = array.astype("U9").astype(object) if rng.random() < 0.2 else array
        with_type = np.dtype(TYPES[rng.integers(len(TYPES))])
        if changed.dtype != object:
            changed = np.zeros(array.shape, with_type)
    elif kind == 3:
        changed = array.astype(float, copy=True) if array.dtype.kind in "fi" else array
        values = (np.nan, np.inf, 1e300, -1e18, 0)
        if changed.size and changed.dtype.kind == "f":
            changed.flat[rng.integers(changed.size)] = values[rng.integers(len(values))]
    else:
        changed = array[..., : rng.integers(3)] if array.ndim else array
    return {**arrays, name: changed}


def forecasts() -> dict[str, Any]:
    """Arrays of forecasts with what happened."""
    paths = np.cumsum(np.full((6, 12, 2), 0.3), axis=1)
    return {
        "samples": np.repeat(paths[None, :, 8:], 3, axis=0),
        "probabilities": np.full(3, 1 / 3),
        "ids": np.arange(6),
        "frames": np.repeat([70, 80], 3),
        "recordings": np.repeat("a", 6),
        "observed": paths[:, :8],
        "truth": paths[:, 8:],
        "scene": np.repeat([0, 1], 3),
        "start": np.repeat([0, 1], 3),
        "period": np.array(0.4),
    }


def npz(arrays: dict[str, Any], name: str = "a.npz") -> Callable[[Path, Rng], Path]:
    """Damage of an archive of arrays."""

    def write(folder: Path, rng: Rng) -> Path:
        file = io.BytesIO()
        is_structured = rng.random() < 2 / 3
        np.savez_compressed(
            file, **(with_array(arrays, rng) if is_structured else arrays)
        )
        content = file.getvalue()
        if not is_structured:
            content = with_bytes(content, rng)
        (folder / name).write_bytes(content)
        return folder / name

    return write


def _as_type(column: pl.Series, kind: Any) -> pl.Series:
    """Numbers in text as another type, whose values may be missing."""
    if kind == pl.Boolean:
        return column == "0"
    return column.cast(kind, strict=False)


def columnar(write_table: Callable[[pl.DataFrame, Path], Any], suffix: str) -> Any:
    """Damage of Parquet or Arrow."""
    types = (pl.String, pl.Boolean, pl.Categorical, pl.Binary, pl.Int8, pl.Float32)

    def write(folder: Path, rng: Rng) -> Path:
        path, table = folder / f"a{suffix}", frame()
        if rng.random() < 2 / 3:
            name = table.columns[rng.integers(4)]
            column = table[name].cast(pl.Int64).cast(pl.String)
            kind = rng.integers(4)
            if kind == 0:
                column = _as_type(column, types[rng.integers(len(types))])
            elif kind == 1:
                column = table[name].reshape((-1, 1))
            elif kind == 2:
                column = pl.Series([None] * len(table))
            else:
                column = table[name].cast(pl.Float64) * 10.0 ** rng.integers(-300, 300)
            table = table.with_columns(column.alias(name))
            if rng.random() < 0.2:
                table = table.head(rng.integers(3))
            write_table(table, path)
            return path
        write_table(table, path)
        path.write_bytes(with_bytes(path.read_bytes(), rng))
        return path

    return write


def sqlite(folder: Path, rng: Rng) -> Path:
    """Damage of a database with a table of metadata."""
    path = folder / "a.sqlite"
    odd = (None, b"\xff\x00", "x", 1e308, -1, 0, "nan", 2**62)
    with sqlite3.connect(path) as base:
        base.execute("create table tracks (frame, id, x, y)")
        base.execute("create table metadata (key, value)")
        rows = [list(row) for row in walk()]
        facts: list[Any] = ["fps", 25]
        if rng.random() < 2 / 3:
            value = odd[rng.integers(len(odd))]
            if rng.random() < 0.5:
                rows[rng.integers(len(rows))][rng.integers(4)] = value
            else:
                facts[rng.integers(2)] = value
        base.executemany("insert into tracks values (?, ?, ?, ?)", rows)
        base.execute("insert into metadata values (?, ?)", facts)
    base.close()
    if rng.random() < 1 / 3:
        path.write_bytes(with_bytes(path.read_bytes(), rng))
    return path


def hdf5(folder: Path, rng: Rng) -> Path:
    """Damage of a file as Jülich's."""
    import h5py

    path = folder / "a.h5"
    kinds = [("id", "i8"), ("frame", "i8"), ("x", "f8"), ("y", "f8")]
    rates = (25.0, 0, -1, "x", np.nan, [1, 2], b"\xff", 1e-300)
    rows = [(person, step, x, y) for step, person, x, y in walk()]
    with h5py.File(path, "w") as file:
        if rng.random() < 1 / 3:
            at = rng.integers(4)
            types = ("f4", "S3", "b1", "(2,)f8", "u1")
            kinds[at] = (kinds[at][0], types[rng.integers(len(types))])
            data: Any = np.zeros(SHAPES[rng.integers(len(SHAPES) - 1)], np.dtype(kinds))
        else:
            data = np.array(rows, dtype=kinds)
        item = file.create_dataset("trajectory", data=data)
        if rng.random() < 0.5:
            item.attrs["fps"] = rates[rng.integers(len(rates))]
    if rng.random() < 1 / 3:
        path.write_bytes(with_bytes(path.read_bytes(), rng))
    return path


def metadata(folder: Path, rng: Rng) -> Path:
    """A table with damaged metadata beside it."""
    (folder / "a.csv").write_text(text_of_walk().partition("\n")[2])
    if rng.random() < 0.5:
        text('{"frameRate": 25, "unit": "m", "id": [1, 2]}', "_meta.json")(folder, rng)
    else:
        text("frameRate,unit\n25,m", "_meta.csv")(folder, rng)
    return folder / "a.csv"


def floor_map(folder: Path, rng: Rng) -> Path:
    """A map of a robot, or its picture, damaged."""
    from PIL import Image

    file = io.BytesIO()
    Image.new("L", (20, 10)).save(file, "PNG")
    picture = file.getvalue()
    if rng.random() < 1 / 3:
        picture = with_bytes(picture, rng)
    (folder / "a.png").write_bytes(picture)
    lines = "image: a.png\nresolution: 0.05\norigin: [0.0, 0.0, 0.0]\nnegate: 0"
    return text(lines, ".yaml")(folder, rng)


def case(folder: Path, rng: Rng) -> Path:
    """A case of parity, or the list of cases, damaged."""
    row = json.loads((CASES / "manifest.json").read_text())[0]
    with np.load(CASES / row["file"]) as arrays:
        npz(dict(arrays), row["file"])(folder, rng)
    if rng.random() < 0.7:
        (folder / "manifest.json").write_text(json.dumps([row]))
        return folder
    text(json.dumps([row]), ".json")(folder, rng).rename(folder / "manifest.json")
    return folder


CASES = Path(__file__).resolve().parents[1] / "tests/golden/fresh"
TRAJNET = "\n".join(
    [
        '{"scene": {"id": 0, "p": 1, "s": 0, "e": 200, "fps": 2.5, "tag": [1, []]}}',
        *(
            json.dumps({"track": {"f": f, "p": p, "x": round(x, 2), "y": round(y, 2)}})
            for f, p, x, y in walk()
        ),
    ]
)
REPORT = json.dumps(
    {"format": FORMAT, "rows": [{"checkpoint": None, "model": "a", "joint_ade": 0.5}]}
)
RECIPE = "model: anchors\nseed: 1\nsteps: 25\nset:\n  ema: 0.9\ndata: a b"
HOMOGRAPHY = "1 0 0\n0 1 0\n0 0.1 1"
JSON = json.dumps([{"frame": f, "id": p, "x": x, "y": y} for f, p, x, y in walk(12)])


def read(path: Path) -> object:
    """The recordings of a file."""
    return read_any(path)


def read_windows(path: Path) -> object:
    """The forecasts of a file, and what happened."""
    return windows_of(read_forecasts(path))


KINDS: dict[str, tuple[Callable[[Path, Rng], Path], Callable[[Path], object]]] = {
    "csv": (text(text_of_walk(), ".csv"), read),
    "csv in seconds": (text(text_of_walk("time [s],id,x [m],y [m]"), ".csv"), read),
    "json": (text(JSON, ".json"), read),
    "trajnet": (text(TRAJNET, ".ndjson"), read),
    "metadata": (metadata, read),
    "parquet": (columnar(pl.DataFrame.write_parquet, ".parquet"), read),
    "arrow": (columnar(pl.DataFrame.write_ipc, ".arrow"), read),
    "sqlite": (sqlite, read),
    "hdf5": (hdf5, read),
    "forecasts": (npz(forecasts()), read_windows),
    "report": (text(REPORT, ".json"), read_report),
    "homography": (text(HOMOGRAPHY, ".txt"), read_homography),
    "map": (floor_map, read_floor_map),
    "recipe": (text(RECIPE, ".yaml"), lambda path: with_file(Options, [str(path)])),
    "parity": (case, run_parity),
}
"""How a file of each kind is made and damaged, and what reads it."""


def damage(kind: str, seed: int, number: int, folder: Path) -> Path:
    """Write the damaged file of a kind with this number."""
    place = list(KINDS).index(kind)
    return KINDS[kind][0](folder, np.random.default_rng([seed, place, number]))


def try_case(kind: str, seed: int, number: int) -> tuple[str, float]:
    """`read`, `refused` or what was raised else, and the seconds that reading took."""
    with tempfile.TemporaryDirectory() as place, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        path = damage(kind, seed, number, Path(place))
        since = time.perf_counter()
        try:
            KINDS[kind][1](path)
            outcome = "read"
        except InputError as error:
            outcome = "refused" if "\n" not in str(error) else "several lines"
        except Exception as error:
            frames = traceback.extract_tb(error.__traceback__)
            where = f"{Path(frames[-1].filename).name}:{frames[-1].lineno}"
            outcome = f"{type(error).__name__} {where} {str(error)[:80]}"
        return outcome, time.perf_counter() - since


def most_memory() -> float:
    """Megabytes that this process took at most so far."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def main() -> int:
    """Print the table; 1 where anything but an InputError was raised."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--count", type=int, default=500, help="files of each kind")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--kind", nargs="+", choices=list(KINDS), default=list(KINDS))
    options = parser.parse_args()
    total, failed = 0, 0
    print("| kind | files | read | refused | else | longest | memory |")
    print("|---|---:|---:|---:|---:|---:|---:|")
    for kind in options.kind:
        try_case(kind, options.seed, -1 % 2**31)  # Imports what it needs.
        before, counts, longest = most_memory(), {"read": 0, "refused": 0}, 0.0
        for number in range(options.count):
            outcome, seconds = try_case(kind, options.seed, number)
            longest = max(longest, seconds)
            if outcome in counts:
                counts[outcome] += 1
            else:
                failed += 1
                print(f"{kind} {number}: {outcome}", file=sys.stderr)
        total += options.count
        others = options.count - sum(counts.values())
        print(
            f"| {kind} | {options.count} | {counts['read']} | {counts['refused']} | {others} "
            f"| {longest:.1f} s | {most_memory() - before:.0f} MB |",
            flush=True,
        )
    print(f"{total} files, {failed} raised anything but an InputError")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
