"""Foreign bytes come through one door: whatever is in a file, it is read, or refused in a line."""

import contextlib
import gzip
import io
import os
import sqlite3
import threading
import zipfile

import numpy as np
import polars as pl
import pytest

from neurosym_jax.data.recordings import read_any
from neurosym_jax.data.tables import ReadOptions
from neurosym_jax.errors import InputError
from neurosym_jax.runtime.foreign import (
    read_arrays,
    read_bytes,
    read_json,
    read_yaml,
    reading,
)
from studies.foreign_bytes import KINDS, try_case
from tests.repository import exhaustive


@pytest.mark.parametrize("count", [12, exhaustive(500)])
@pytest.mark.parametrize("kind", KINDS)
def test_damaged_files_are_read_or_refused_in_a_line(kind, count):
    outcomes = {number: try_case(kind, 1, number) for number in range(count)}
    wrong = {
        number: outcome
        for number, (outcome, _) in outcomes.items()
        if outcome not in ("read", "refused")
    }
    assert wrong == {}
    assert max(seconds for _, seconds in outcomes.values()) < 30


def test_the_command_knows_both_outcomes():
    """Else the table would show nothing: whole files are read, and damage is noticed."""
    outcomes = {try_case("forecasts", 0, number)[0] for number in range(20)}
    assert outcomes == {"read", "refused"}


class Panic(BaseException):
    pass


Panic.__name__ = "PanicException"


@pytest.mark.parametrize(
    "error",
    [ValueError("a\nb"), MemoryError(), RecursionError("deep"), KeyError("x"), Panic()],
)
def test_whatever_a_library_raises_names_the_file_in_a_line(error):
    with (
        pytest.raises(InputError, match=r"^a\.npz: cannot be read as a case") as caught,
        reading("a.npz", "a case"),
    ):
        raise error
    assert "\n" not in str(caught.value)
    assert caught.value.__cause__ is error


@pytest.mark.parametrize("error", [KeyboardInterrupt(), SystemExit(3)])
def test_a_wish_to_end_goes_through(error):
    with pytest.raises(type(error)), reading("a.npz"):
        raise error


def test_a_refusal_has_the_name_once():
    for text in ("row 3: no number", "a.csv: row 3: no number"):
        refusal = pytest.raises(InputError, match=r"^a\.csv: row 3: no number$")
        with refusal, reading("a.csv"):
            raise InputError(text)


def archive(path, *parts, compression=zipfile.ZIP_DEFLATED):
    with zipfile.ZipFile(path, "w", compression) as file:
        for name, content in parts:
            file.writestr(name, content)
    return path


def array_file(array):
    file = io.BytesIO()
    np.save(file, array)
    return file.getvalue()


def test_arrays_come_back_as_they_are(tmp_path):
    """Good input that the guards could harm: empty, in Fortran's order, compressed by 200."""
    arrays = {
        "empty": np.zeros((0, 3)),
        "fortran": np.asfortranarray(np.arange(6.0).reshape(2, 3)),
        "number": np.array(3),
        "names": np.array(["a", "bc"]),
        "zeros": np.zeros(4_000_000),
    }
    np.savez_compressed(tmp_path / "a.npz", **arrays)
    read = read_arrays(tmp_path / "a.npz")
    for name, array in arrays.items():
        np.testing.assert_array_equal(read[name], array, strict=True)


def test_archives_that_are_no_arrays_of_ours_are_refused_before_they_take_memory(
    tmp_path,
):
    plain = array_file(np.zeros(3))
    header = plain.replace(b"(3,)", b"(3" + b"0" * 12 + b",)")
    header = header.replace(b" " * 12, b"", 1)
    objects = io.BytesIO()
    np.save(objects, np.array([{}], dtype=object), allow_pickle=True)
    for parts, reason in (
        ([("a.npy", plain), ("A.npy", plain)], "refused: 2 entries have the name a"),
        ([("a.npy", plain), ("a", plain)], "refused: 2 entries have the name a"),
        ([("a.npy", bytes(300_000_000))], "unpacks to 300 MB"),
        ([("a.npy", header)], "array a: .* bytes for shape"),
        ([("a.npy", objects.getvalue())], "array a: holds objects"),
        ([("a.npy", b"text")], "array a: "),
    ):
        path = archive(tmp_path / "a.npz", *parts)
        with pytest.raises(InputError, match=rf"a\.npz: {reason}"):
            read_arrays(path)


def test_settings_have_no_alias_and_files_a_size(tmp_path):
    path = tmp_path / "a.yaml"
    path.write_text("a: &x [1, 1]\nb: [*x, *x]")
    with pytest.raises(InputError, match=r"a\.yaml: has an alias"):
        read_yaml(path)
    path.write_text("a: '*x'\nb: 1 & 2")
    assert read_yaml(path) == {"a": "*x", "b": "1 & 2"}
    path.write_bytes(b"#" * 100)
    assert len(read_bytes(path, 100)) == 100
    with pytest.raises(InputError, match="has more than the 0 MB"):
        read_bytes(path, 99)
    path.write_text('{"a": 1, "a": 2}')
    with pytest.raises(InputError, match="the key 'a' stands twice"):
        read_json(path)


def test_tables_that_unpack_to_any_size_are_refused(tmp_path):
    rows = 2_000_000
    table = pl.DataFrame({"frame": np.zeros(rows, int)})
    for name in ("id", "x", "y"):
        table = table.with_columns(pl.lit(1.0).alias(name))
    table.write_parquet(tmp_path / "a.parquet")
    with pytest.raises(InputError, match=r"a\.parquet: 8e\+06 values"):
        read_any(tmp_path / "a.parquet")
    (tmp_path / "a.txt.gz").write_bytes(gzip.compress(b"0 1 2 3\n" * 33_000_000, 1))
    with pytest.raises(InputError, match="unpacks to more than"):
        read_any(tmp_path / "a.txt.gz")


def test_a_database_runs_nothing_of_its_own_and_has_no_giant_field(tmp_path):
    path = tmp_path / "a.sqlite"
    with sqlite3.connect(path) as base:
        base.execute("create table tracks (frame, id, x, y)")
        base.execute("insert into tracks values (0, 1, zeroblob(2000000), 1)")
    base.close()
    with pytest.raises(InputError, match=r"a\.sqlite: cannot be read as sqlite"):
        read_any(path)


@pytest.mark.filterwarnings("error::RuntimeWarning")
def test_a_rate_of_nothing_in_a_comment_is_refused_and_can_be_said(tmp_path):
    rows = [f"{f},{p},{0.4 * f},{p}" for f in range(20) for p in range(2)]
    path = tmp_path / "a.csv"
    path.write_text("\n".join(["# frame rate: 0", "frame,id,x,y", *rows]))
    with pytest.raises(InputError, match=r"a\.csv: the comment .* say fps=25"):
        read_any(path)
    (tracks,) = read_any(path, ReadOptions(fps=2.5))
    assert tracks.stamp.max() == pytest.approx(19 / 2.5)


@pytest.mark.skipif(
    not hasattr(os, "mkfifo"), reason="this system has no pipes in folders"
)
def test_a_pipe_is_not_read_to_its_end(tmp_path):
    os.mkfifo(tmp_path / "a.json")
    written: list[int] = []

    def write() -> None:
        with (
            contextlib.suppress(BrokenPipeError),
            open(tmp_path / "a.json", "wb", 0) as pipe,
        ):
            for _ in range(64):
                written.append(pipe.write(bytes(2**16)))

    writer = threading.Thread(target=write, daemon=True)
    writer.start()
    with pytest.raises(InputError, match="has more than the 0 MB"):
        read_bytes(tmp_path / "a.json", 1000)
    writer.join(10)
    assert sum(written) < 2**22
