import json

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal

from neurosym_jax.data.readers.trajnet import (
    TrajnetForecast,
    TrajnetScene,
    read_trajnet,
    write_trajnet,
)
from neurosym_jax.data.tracks import make_tracks
from neurosym_jax.errors import InputError

finite = st.floats(-1e8, 1e8)
rows = st.dictionaries(
    st.tuples(st.integers(0, 99), st.integers(0, 9)), st.tuples(finite, finite), min_size=1
)


@settings(max_examples=40, deadline=None)
@given(rows=rows)
def test_round_trip(rows, tmp_path_factory):
    keys = np.array(list(rows))
    # Every frame is there, so that the most common step is one.
    frames = np.arange(100) * 0.4
    stamp = np.append(keys[:, 0] * 0.4, frames)
    tracks = make_tracks(
        "a",
        stamp,
        np.append(keys[:, 1], np.full(100, 77)),
        np.concatenate([np.array(list(rows.values())), np.zeros((100, 2))]),
    )
    path = write_trajnet(tmp_path_factory.mktemp("t") / "a.ndjson", tracks)
    back = read_trajnet(path).tracks
    assert_allclose(back.stamp, tracks.stamp, atol=1e-9)
    assert_array_equal(back.id, tracks.id)
    assert_array_equal(back.position, tracks.position)


def test_scenes_and_forecasts(tmp_path):
    tracks = make_tracks("a", [0, 0.4, 0.8], [5, 5, 5], [[0, 0], [1, 0], [2, 0.1]])
    scene = TrajnetScene(0, 5, 0.0, 1.6, [1, []])
    forecast = TrajnetForecast(0, 2, 5, 1.2, np.array([[3, 0.25], [4, 0.5]]))
    path = write_trajnet(tmp_path / "new/a.ndjson", tracks, [scene], [forecast])
    lines = [json.loads(line) for line in path.read_text().splitlines()]
    assert lines[0] == {"scene": {"id": 0, "p": 5, "s": 0, "e": 4, "fps": 2.5, "tag": [1, []]}}
    assert lines[1] == {"track": {"f": 0, "p": 5, "x": 0.0, "y": 0.0}}
    point = {"f": 3, "p": 5, "x": 3.0, "y": 0.25, "prediction_number": 2, "scene_id": 0}
    assert lines[4] == {"track": point}
    back = read_trajnet(path)
    assert back.scenes == (scene,)
    assert back.period == 0.4
    assert_array_equal(back.tracks.position, tracks.position)
    (found,) = back.forecasts
    assert (found.scene, found.sample, found.person) == (0, 2, 5)
    assert found.start == pytest.approx(1.2)
    assert_array_equal(found.position, forecast.position)


def test_frames_that_step_by_ten(tmp_path):
    points = [{"track": {"f": 10 * f, "p": 1, "x": f, "y": 0}} for f in range(3)]
    scene = {"scene": {"id": 1, "p": 1, "s": 0, "e": 20, "fps": 2.5}}
    path = tmp_path / "a.ndjson"
    path.write_text("\n".join(map(json.dumps, [scene, *points])))
    back = read_trajnet(path)
    assert_allclose(back.tracks.stamp, [0, 0.4, 0.8])
    assert back.scenes[0].end == pytest.approx(0.8)
    assert_allclose(read_trajnet(path, stride=5).tracks.stamp, [0, 0.8, 1.6])


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "the file has no track rows"),
        ('{"track": {"f": 1', "row 1 is not JSON"),
        ("[1]", "row 1 is neither a track nor a scene"),
        ('{"track": {"f": 1, "p": 1, "x": 0}}', "row 1: y is 'None', not a usable number"),
        ('{"track": {"f": 1.5, "p": 1, "x": 0, "y": 0}}', "row 1: f 1.5 is not a whole"),
        ('{"track": {"f": 1, "p": 1, "x": NaN, "y": 0}}', "row 1: x is 'nan', not"),
        ('{"track": {"f": 1, "p": 1, "x": 1e12, "y": 0}}', "row 1: position"),
        ('{"scene": {"id": 1, "p": 1, "s": 0, "e": 1, "fps": 0}}', "row 1: fps is 0"),
        ('{"track": {"f": 1, "p": 1, "x": 1, "y": 0}}\n' * 2, "row 2 repeats"),
        ('{"track": {"f": 1' + "0" * 5000 + "}}", "row 1 is not JSON"),
    ],
)
def test_bad_files(tmp_path, text, message):
    path = tmp_path / "a.ndjson"
    path.write_text(text)
    with pytest.raises(InputError, match=message):
        read_trajnet(path)


def test_what_cannot_be_written(tmp_path):
    tracks = make_tracks("a", [0.1, 0.4], [1, 1], [[0, 0], [1, 1]])
    with pytest.raises(InputError, match=r"0\.1 s is not a multiple of 0\.4 s: resample first"):
        write_trajnet(tmp_path / "a.ndjson", tracks)
    good = make_tracks("a", [0.0], [1], [[0, 0]])
    forecast = TrajnetForecast(0, 0, 1, 0.4, np.zeros(3))
    with pytest.raises(InputError, match=r"a forecast must be \[T, 2\] and finite"):
        write_trajnet(tmp_path / "a.ndjson", good, forecasts=[forecast])
