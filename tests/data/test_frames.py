"""Dataframes of pandas and polars are read as the table of the same text is, and refused alike."""

import dataclasses
import io
import re
from types import SimpleNamespace

import numpy as np
import polars as pl
import pytest

import neurosym_jax as nj
from neurosym_jax.data import ReadOptions, read_any, windows_from
from neurosym_jax.errors import InputError
from neurosym_jax.evaluation.compare import baseline
from studies.mistakes.crowd import CROWD, table

pytestmark = pytest.mark.filterwarnings("ignore::neurosym_jax.errors.InputWarning")
ROBOT = np.where(CROWD.id == 5, "robot", "person")
STAMPS = [f"2024-05-01T12:{int(t) // 60:02}:{t % 60:06.3f}Z" for t in CROWD.t]
CASES = {  # From "no ids" on they are refused.
    # text of a table, and options with which it is read
    "metres": (table(), {}),
    "kinds": (table(label=ROBOT), {}),
    "dates": (table(t=STAMPS), {}),
    "runs": (
        table(run=np.where(CROWD.id % 2, "a", "b")),
        {"columns": ["id=id", "pace=x"]},
    ),
    "frames": (table(t=None, frame=10 * CROWD.step), {"fps": 25.0}),
    "an id missing": (table(id=["" if n == 7 else n for n in CROWD.id]), {}),
    "a point twice": (table() + table().split("\n")[9] + "\n", {}),
    "no ids": (table(id=None), {}),
    "not a number": (table(x=np.where(CROWD.step == 9, "x4", CROWD.x.astype(str))), {}),
}


def frame_of(library, text):
    if library == "polars":
        return pl.read_csv(io.StringIO(text), try_parse_dates=True)
    pandas = pytest.importorskip("pandas")
    frame = pandas.read_csv(io.StringIO(text))
    return frame.assign(t=pandas.to_datetime(frame["t"])) if "T12" in text else frame


def told(data, options):
    """The recordings and how they were read, or what was refused."""
    try:
        return read_any(data, ReadOptions(**options))
    except InputError as error:
        return str(error)


@pytest.mark.parametrize("library", ["polars", "pandas"])
@pytest.mark.parametrize("name", CASES)
def test_as_text(tmp_path, library, name):
    text, options = CASES[name]
    path = tmp_path / "dataframe.csv"
    path.write_text(text)
    expected, result = told(path, options), told(frame_of(library, text), options)
    assert isinstance(expected, str) == (
        list(CASES).index(name) >= list(CASES).index("no ids")
    )
    if isinstance(expected, str):
        # Rows are counted from 0 and without a header; a library writes in its way what
        # is missing.
        told_of = r"(?:.*dataframe(?:\.csv)?: )(?:row (\d+): )?([^:(]*)"
        (row, reason), (row_here, same) = (
            re.match(told_of, outcome).groups() for outcome in (expected, result)
        )
        assert same == reason
        assert row is None or int(row_here) == int(row) - 2
        return
    for tracks, other in zip(result, expected, strict=True):
        assert tracks.reading == dataclasses.replace(other.reading, file=None)
        for outcome in ("recording", "stamp", "id", "position", "extras"):
            np.testing.assert_equal(getattr(tracks, outcome), getattr(other, outcome))


def test_objects_of_pedpy_and_movingpandas_are_known_by_what_they_have():
    """The first has its rate beside the table; the second a frame a person, indexed by time."""
    pytest.importorskip("pandas")
    frame = frame_of("pandas", table(t=None, frame=CROWD.step))
    pedpy = SimpleNamespace(data=frame, frame_rate=2.5)
    timed = frame_of("pandas", table(t=STAMPS)).set_index("t")
    people = [SimpleNamespace(df=part) for _, part in timed.groupby("id")]
    movingpandas = SimpleNamespace(trajectories=people)
    (expected,) = read_any(frame_of("pandas", table()))
    for data in (pedpy, movingpandas):
        (tracks,) = read_any(data)
        np.testing.assert_array_equal(tracks.id, expected.id)
        np.testing.assert_array_equal(tracks.position, expected.position)
        seconds = tracks.stamp - tracks.stamp.min()
        np.testing.assert_allclose(
            seconds, expected.stamp - expected.stamp.min(), atol=1e-6
        )


def test_wherever_recordings_are_taken(tmp_path):
    text = table(CROWD.scaled(0.01)).replace("id", "who", 1)
    frame, path = frame_of("polars", text), tmp_path / "dataframe.csv"
    path.write_text(text)
    options = {"columns": ("id=who",), "unit": "cm"}
    model = baseline("constant_velocity", 8, 8)
    rows = [
        nj.evaluate(model, data, samples=1, baselines=(), **options).select(
            pl.col("^joint.*$")
        )
        for data in (frame, path)
    ]
    assert rows[1].equals(rows[0])
    with pytest.raises(InputError, match="dataframe: which column is id"):
        nj.evaluate(model, frame)
    windows = [
        windows_from(data, 8, 8, read=ReadOptions(**options))
        for data in (frame, [frame, path])
    ]
    assert windows[1].agents == 2 * windows[0].agents > 0
    with pytest.raises(
        InputError, match=r"dataframe: it is a table with .*, not format='text'"
    ):
        read_any(frame, ReadOptions(format="text"))
    with pytest.raises(InputError, match="dataframe: has no rows"):
        read_any(frame[:0])
    with pytest.raises(InputError, match="is no recording"):
        windows_from(np.zeros((3, 8, 5)), 4, 4)
    with pytest.raises(
        InputError, match=r"7\.0: is no recording: give a file, table or"
    ):
        windows_from(7.0, 4, 4)


@pytest.mark.filterwarnings("error")
def test_a_lazy_frame_is_read_without_a_warning():
    frame = frame_of("polars", table())
    assert len(read_any(frame.lazy())[0].id) == len(frame)
