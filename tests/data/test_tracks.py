"""The track table: what it refuses, and what resampling may and may not invent."""

import ast
import dataclasses
import re

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_array_equal

from neurosym_jax.data.recordings import read_any
from neurosym_jax.data.tables import ReadOptions
from neurosym_jax.data.tracks import (
    SNAP,
    Reading,
    Tracks,
    make_tracks,
    on_grid,
    resample,
)
from neurosym_jax.errors import InputError


def one(stamp, x=None):
    """One agent who walks along x."""
    x = np.asarray(stamp if x is None else x, float)
    return make_tracks(
        "r", stamp, np.ones(len(stamp)), np.stack([x, np.zeros_like(x)], -1)
    )


@st.composite
def tracks(draw):
    """A few agents with steps and gaps of all sizes, rows shuffled."""
    rng = np.random.default_rng(draw(st.integers(0, 999)))
    start = draw(st.sampled_from([0.0, -3.7, 1.6e9]))
    counts = rng.integers(1, 26, draw(st.integers(1, 3)))
    ticks = np.concatenate([rng.choice(401, count, replace=False) for count in counts])
    ids = np.repeat(np.arange(len(counts)) * 7 - 5, counts)
    order = rng.permutation(len(ids))
    points = rng.normal(size=(len(ids), 2)) * 4
    return make_tracks("r", start + 0.03 * ticks[order], ids[order], points)


@pytest.mark.parametrize(
    ("stamp", "id", "position", "extra", "message"),
    [
        (
            [0, 1],
            [1, 1],
            [[0, 0], [0, np.nan]],
            [0, 0],
            "row 1: position .* is not a usable",
        ),
        (
            [0, np.inf],
            [1, 1],
            [[0, 0], [0, 0]],
            [0, 0],
            "row 1: time inf is not a usable number",
        ),
        (
            [3, 0, 3],
            [1, 1, 1],
            np.zeros((3, 2)),
            [0, 0, 0],
            "row 2: repeats agent 1 at 3 s",
        ),
        (
            [0, 1],
            [1, 1.5],
            np.zeros((2, 2)),
            [0, 0],
            "row 1: id 1.5 is not a usable number",
        ),
        (
            [0, 1],
            np.uint64([1, 2**63]),
            np.zeros((2, 2)),
            [0, 0],
            "row 1: id 9223372036854775808",
        ),
        (
            [0, 1],
            [b"a", b"b"],
            np.zeros((2, 2)),
            [0, 0],
            r"id must be numbers \[2\], not \[2\] \|S1",
        ),
        (
            [0, 1],
            [1, 1],
            np.zeros((2, 3)),
            [0, 0],
            r"position must be numbers \[2, 2\], not",
        ),
        (
            [[0, 1]],
            [1, 1],
            np.zeros((2, 2)),
            [0, 0],
            r"stamp must be numbers \[2\], not \[1, 2\]",
        ),
        ([], [], np.zeros((0, 2)), [], r"stamp must be numbers \[0\]"),
        (
            [0, 1],
            [1, 1],
            np.zeros((2, 2)),
            [1],
            r"group must be numbers \[2\], not \[1\]",
        ),
    ],
)
def test_refusals_name_recording_row_and_reason(stamp, id, position, extra, message):
    with pytest.raises(InputError, match=f"hall: {message}"):
        make_tracks("hall", stamp, id, position, {"group": extra})


def test_a_selection_forgets_nothing():
    reading = Reading("r", rows=4)
    points = np.arange(10.0).reshape(5, 2)
    table = make_tracks(
        "r",
        [0.7, 0.4, 0.8, 0.3, 0],
        [2.0, 1, 1, 2, 1],
        points,
        {"group": [8, 7, 7, 8, 7]},
    )
    points[:] = 0  # The table has copies.
    assert_array_equal(table.position[:, 0], [8, 2, 4, 6, 0])
    assert (table.id.dtype, table.stamp.dtype) == (np.int64, np.float64)
    grid = resample(dataclasses.replace(table, reading=reading), 0.2)
    assert_array_equal(grid.extras["group"], np.where(grid.id == 1, 7, 8))
    mask = grid.stamp >= 0.5
    part = grid.take(mask)
    for name in ("stamp", "id", "position", "known", "foreseen"):
        assert_array_equal(getattr(part, name), getattr(grid, name)[mask])
    assert_array_equal(part.extras["group"], grid.extras["group"][mask])
    assert (part.recording, part.period) == ("r", 0.2)
    assert part.reading == dataclasses.replace(reading, filled=4)
    swapped = grid.with_ids(3 - grid.id)
    assert_array_equal(swapped.id, np.sort(3 - grid.id))
    assert_array_equal(swapped.extras["group"], np.where(swapped.id == 1, 8, 7))
    back = swapped.with_ids(3 - swapped.id)
    for name in ("stamp", "id", "position"):
        assert_array_equal(getattr(back, name), getattr(grid, name))
    with pytest.raises(InputError, match=r"repeats agent 1 at 0\.4 s"):
        grid.with_ids(np.ones_like(grid.id))


def test_decimal_and_accumulated_clocks_meet_the_grid():
    walked = np.random.default_rng(0).normal(size=500)
    for stamp in (
        np.cumsum(np.full(500, 0.1)),
        1.7e9 + np.round(np.arange(500) * 0.1, 3),
    ):
        grid = resample(one(stamp, walked), 0.4)
        assert_array_equal(grid.position[:, 0], walked[::4])
    for arguments in ((0.0,), (0.4, -1.0), (0.4, 1.0, np.nan), (0.4, 1.0, 99.0)):
        with pytest.raises(InputError, match="r: "):
            resample(one([0, 1, 2]), *arguments)


def test_tracks_on_the_grid_stay_as_they_are():
    regular = one([0, 0.4, 0.8, 1.2, 1.6])
    assert on_grid(regular).position is regular.position
    assert on_grid(regular, 0.2).position is not regular.position


def test_a_gap_of_one_second_is_bridged_by_default_and_no_longer_one():
    for gap, steps in ((1.0, 5), (1.2, 3)):
        assert len(on_grid(one([0, 0.2, 0.4, 0.4 + gap, 0.6 + gap])).id) == steps, gap


@given(tracks(), st.floats(0.05, 1.0), st.floats(0.0, 1.5), st.floats(-0.5, 0.5))
def test_properties_against_an_agent_by_agent_reference(table, period, max_gap, shift):
    start = table.stamp.min() + shift
    try:
        grid = resample(table, period, max_gap, start)
    except InputError:
        grid = Tracks("r", np.zeros(0), np.zeros(0, int), np.zeros((0, 2)))
    slack = max_gap + 2 * SNAP
    expected = []
    for agent in np.unique(table.id):
        rows = table.id == agent
        stamp, position = table.stamp[rows], table.position[rows]
        for n in range(int((stamp[-1] - start) / period) + 2):
            point = start + n * period
            near = np.abs(stamp - point) <= SNAP
            after = np.searchsorted(stamp, point)
            if near.any():
                expected.append((agent, point, *position[near][0]))
            elif 0 < after < len(stamp) and stamp[after] - stamp[after - 1] <= slack:
                where = [np.interp(point, stamp, position[:, axis]) for axis in (0, 1)]
                expected.append((agent, point, *where))
    assert len(grid.id) == len(expected)
    points = np.column_stack([grid.id, grid.stamp, grid.position])
    np.testing.assert_allclose(points, np.reshape(expected, (-1, 4)), rtol=0, atol=1e-4)


def test_ids_may_be_texts_in_any_array():
    position = np.arange(8.0).reshape(4, 2)
    for kind in (str, object):
        ids = np.array(["ben", "anna", "ben", "anna"], kind)
        tracks = make_tracks("hall", [0, 0, 1, 1], ids, position)
        assert tracks.id.tolist() == [0, 0, 1, 1]
        assert tracks.ids_as_given().tolist() == ["anna", "anna", "ben", "ben"]
        assert tracks.ids_as_given(slice(1, 3)).tolist() == ["anna", "ben"]
    with pytest.raises(InputError, match="repeats agent ben at 0 s"):
        make_tracks("hall", [0, 0, 0, 1], ids, position)


def test_a_column_that_may_tell_recordings_apart_is_named(tmp_path):
    rows = ["batch,t,id,x,y"]
    for clip in (1, 2):
        rows += [f"{clip},{0.4 * t},7,{0.5 * t},{clip}" for t in range(9)]
    path = tmp_path / "clips.csv"
    path.write_text("\n".join(rows))
    with pytest.raises(InputError, match="row 11: repeats agent 7") as refused:
        read_any(path)
    columns = re.search(r"columns=(\(.*?\))", str(refused.value))
    assert columns, refused.value
    first, second = read_any(path, ReadOptions(columns=ast.literal_eval(columns[1])))
    assert (first.recording, second.recording) == ("clips_1", "clips_2")
