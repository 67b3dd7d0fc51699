import json

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal

from neurosym_jax.data.readers.columns import parse_columns, read_columns
from neurosym_jax.data.reading import ReadOptions
from neurosym_jax.errors import InputError

NAMED = ReadOptions(columns=("time=t0", "id=who", "x=px", "y=py"))


def test_named_columns(tmp_path):
    path = tmp_path / "mine.csv"
    path.write_text("who;px;note;py;t0\nAnn;1000;a;2000;0.5\nBob;-3;b;4;0.5\nAnn;1500;c;2000;1\n")
    tracks = read_columns(path, NAMED)
    assert_array_equal(tracks.id, [0, 0, 1])
    assert_array_equal(tracks.stamp, [0.5, 1, 0.5])
    assert_array_equal(tracks.position, [[1000, 2000], [1500, 2000], [-3, 4]])


@pytest.mark.parametrize("separator", [",", "\t", "; ", " "])
def test_usual_names_and_frames(tmp_path, separator):
    rows = [["Frame", "ped_id", "X", "y"], ["10", "4", "1", "2"], ["20", "4", "1.5", "2"]]
    (tmp_path / "a.csv").write_text("\n".join(separator.join(row) for row in rows))
    tracks = read_columns(tmp_path / "a.csv")
    assert_allclose(tracks.stamp, [0.4, 0.8])
    assert_array_equal(tracks.id, [4, 4])
    assert_allclose(read_columns(tmp_path / "a.csv", ReadOptions(stride=5)).stamp, [0.8, 1.6])


finite = st.floats(-1e8, 1e8)
tables = st.dictionaries(
    st.tuples(finite, st.integers(-(2**50), 2**50)), st.tuples(finite, finite), min_size=1
)


@pytest.mark.filterwarnings("ignore:.*runs backward")
@settings(max_examples=50, deadline=None)
@given(table=tables, form=st.sampled_from(["csv", "records", "lists", "lines"]))
def test_round_trip(table, form, tmp_path_factory):
    rows = [dict(zip(("t0", "who", "px", "py"), key + xy)) for key, xy in table.items()]
    text = {
        "csv": "\n".join(["t0,who,px,py", *[",".join(map(repr, r.values())) for r in rows]]),
        "records": json.dumps(rows),
        "lists": json.dumps({name: [row[name] for row in rows] for name in rows[0]}),
        "lines": "\n".join(map(json.dumps, rows)),
    }[form]
    path = tmp_path_factory.mktemp("c") / "a"
    path.write_text(text)
    tracks = read_columns(path, NAMED)
    found = zip(tracks.stamp.tolist(), tracks.id.tolist(), tracks.position.tolist())
    assert {(time, id): tuple(xy) for time, id, xy in found} == table


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("t,id,x\n1,2,3\n", "which column is y"),
        ("id,x,y\n1,2,3\n", "which column is time or frame"),
        ("t,id,x,y\n1,2,3\n", "row 1 has 3 of 4 columns"),
        ("t,id,x,y\n1,2,3,q\n", "row 1: y 'q' is not a number"),
        ("t,id,x,y\n1,2,3,inf\n", "row 1: y is not finite"),
        ("t,id,x,y\n1,2,3,1e99\n", "row 1: position .* is not a usable number"),
        ("t,id,x,y\n1e99,2,3,1\n", "row 1: time 1e.99 is not a usable number"),
        ("t,id,x,y\n", "the table has no rows"),
        ("t,id,x,y\n1,2,3,4\n1,2,3,5\n", r"row 2 repeats \(time 1, id 2\)"),
        ("{}", "the table has no columns"),
        ("[]", "a table in JSON is a list"),
        ("[1]", "a table in JSON is a list of objects"),
        ('[{"t": 1, "id": 1, "x": 0, "y": 0}, 1]', "row 2 is not an object"),
        ("[" * 100_000, "neither JSON nor"),
        ('{"t": [1], "id": []}', "different lengths"),
        ('[{"t": 1, "id": 1, "x": [], "y": 0}]', "row 1: x .* is not a number"),
    ],
)
def test_bad_tables(tmp_path, text, message):
    (tmp_path / "a").write_text(text)
    with pytest.raises(InputError, match=message):
        read_columns(tmp_path / "a")


def test_bad_names(tmp_path):
    (tmp_path / "a").write_text("t,id,x,y\n1,2,3,4\n")
    with pytest.raises(InputError, match="no column 'px' among 't', 'id', 'x', 'y'"):
        read_columns(tmp_path / "a", ReadOptions(columns=("x=px",)))
    for pairs in (["time"], ["when=t"], ["x=a", "x=b"], ["x="]):
        with pytest.raises(InputError, match="columns are given as time="):
            parse_columns(pairs)
