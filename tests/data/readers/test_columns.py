import gzip
import json

import numpy as np
import polars as pl
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal

from neurosym_jax.data import ReadOptions, read_any, single_scene, windows_from
from neurosym_jax.data.readers.columns import parse_columns, read_columns
from neurosym_jax.errors import InputError

NAMED = ReadOptions(columns=("time=t0", "id=who", "x=px", "y=py"))


def test_named_columns(tmp_path):
    path = tmp_path / "mine.csv"
    path.write_text("who;px;note;py;t0\nAnn;1000;a;2000;0.5\nBob;-3;b;4;0.5\nAnn;1500;c;2000;1\n")
    (tracks,) = read_columns(path, NAMED)
    assert_array_equal(tracks.id, [0, 0, 1])
    assert_array_equal(tracks.stamp, [0.5, 1, 0.5])
    assert_array_equal(tracks.position, [[1000, 2000], [1500, 2000], [-3, 4]])


@pytest.mark.parametrize("separator", [",", "\t", "; ", " "])
def test_usual_names_and_frames(tmp_path, separator):
    rows = [["Frame", "ped_id", "X", "y"], ["10", "4", "1", "2"], ["20", "4", "1.5", "2"]]
    (tmp_path / "a.csv").write_text("\n".join(separator.join(row) for row in rows))
    (tracks,) = read_columns(tmp_path / "a.csv")
    assert_allclose(tracks.stamp, [0.4, 0.8])
    assert_array_equal(tracks.id, [4, 4])
    assert_allclose(read_columns(tmp_path / "a.csv", ReadOptions(stride=5))[0].stamp, [0.8, 1.6])


finite = st.floats(-1e8, 1e8)
tables = st.dictionaries(
    st.tuples(finite, st.integers(-(2**50), 2**50)), st.tuples(finite, finite), min_size=1
)


@pytest.mark.filterwarnings("ignore:.*runs backward")
@given(table=tables, form=st.sampled_from(["csv", "lines"]))
def test_round_trip(table, form, tmp_path_factory):
    rows = [dict(zip(("t0", "who", "px", "py"), key + xy)) for key, xy in table.items()]
    text = {
        "csv": "\n".join(["t0,who,px,py", *[",".join(map(repr, r.values())) for r in rows]]),
        "lines": "\n".join(map(json.dumps, rows)),
    }[form]
    path = tmp_path_factory.mktemp("c") / "a"
    path.write_text(text)
    (tracks,) = read_columns(path, NAMED)
    found = zip(tracks.stamp.tolist(), tracks.id.tolist(), tracks.position.tolist())
    assert {(time, id): tuple(xy) for time, id, xy in found} == table


def test_bad_names(tmp_path):
    (tmp_path / "a").write_text("t,id,x,y\n1,2,3,4\n")
    with pytest.raises(InputError, match="no column 'px' among 't', 'id', 'x', 'y'"):
        read_columns(tmp_path / "a", ReadOptions(columns=("x=px",)))
    for pairs in (["time"], ["2=t"], ["x=a", "x=b"], ["x="], ["group=a", "group=b"]):
        with pytest.raises(InputError, match="columns are given as time="):
            parse_columns(pairs)


@pytest.mark.parametrize("ending", ["csv", "csv.gz", "parquet", "arrow"])
def test_every_container_says_the_same(tmp_path, ending):
    """Text, ids that are texts, dates, numbers that are missing in an extra."""
    path = tmp_path / f"walk.{ending}"
    frame = pl.DataFrame(
        {
            "time": ["2024-05-01T12:00:00.0", "2024-05-01T12:00:00.4", "2024-05-01T12:00:00.0"],
            "person": ["b", "b", "a"],
            "x [cm]": [100.0, 150.5, -3.0],
            "y [cm]": [1, 2, 3],
            "g": [7.0, 7.0, None],
            "kind": ["adult", "adult", "child"],
        }
    )
    if ending == "parquet":
        frame.with_columns(pl.col("time").str.to_datetime()).write_parquet(path)
    elif ending == "arrow":
        frame.write_ipc(path)
    else:
        content = frame.write_csv().encode()
        path.write_bytes(gzip.compress(content) if ending == "csv.gz" else content)
    (tracks,) = read_any(path, ReadOptions(columns=("group=g", "kind=kind")))
    assert tracks.recording == "walk"
    assert_array_equal(tracks.id, [0, 1, 1])
    assert_allclose(tracks.stamp - tracks.stamp[0], [0, 0, 0.4], atol=1e-6)
    assert_allclose(tracks.position, [[-0.03, 0.03], [1, 0.01], [1.505, 0.02]])
    assert_array_equal(tracks.extras["group"], [np.nan, 7, 7])
    assert_array_equal(tracks.extras["kind"], [1, 0, 0])
    windows = windows_from(path, 1, 1, min_agents=1, read=ReadOptions(columns=("group=5",)))
    assert single_scene(windows, 0).extras["group"].tolist() == [7, 0, 0, 0]


def test_quoted_fields(tmp_path):
    path = tmp_path / "a.csv"
    path.write_text('"t","id","x","y"\n0,"7, junior","1.5",2\n0.4,"7, junior",1.75, "2"\n')
    (tracks,) = read_any(path)
    assert_array_equal(tracks.position, [[1.5, 2], [1.75, 2]])
    path.write_text('t,id,x,y\n0,"7\n",1,2\n')
    with pytest.raises(InputError, match="row 1: a quoted field goes on in the next line"):
        read_any(path)
