"""What the page is told is what was seen and forecast, bounded, whatever comes; maps are ROS's."""

import base64
import io
import json
import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from neurosym_jax.models.forecast import Model
from neurosym_jax.models.sgan.network import GeneratorConfig
from neurosym_jax.symbolic.qtc import observe
from neurosym_jax.symbolic.weighting import Soft, initial_parameters
from neurosym_robot.dashboard.moments import MAX_NAMED, UNKNOWN, read_floor_map
from neurosym_robot.dashboard.pair_symbols import PairSymbols
from neurosym_robot.online.pairs import LikelyEvent
from neurosym_robot.online.replay import ReplayEvent, advance
from neurosym_robot.tracking.following import Frame
from tests.robot.dashboard.conftest import predictor

NOW = {"missing": {}, "score": {}, "flows": None}


def test_a_forecast_is_told_whole_once_a_period(moments, stream):
    events = list(stream(6))
    moments_of_stream = [json.loads(moments.moment(*event)) for event in events]
    assert [n for n, moment in enumerate(moments_of_stream) if moment["step"]] == list(
        range(28, 60, 4)
    )
    (frame, forecast, *_), now = events[56]
    moments_of_stream = moments_of_stream[56]
    assert moments_of_stream["ids"] == [str(id) for id in frame.ids]
    assert_allclose(np.reshape(moments_of_stream["xy"], (-1, 2)), frame.xy, atol=6e-4)
    step = moments_of_stream["step"]
    assert_allclose(np.reshape(step["seen"], (3, 8, 2)), forecast.observed, atol=6e-4)
    for name, result in forecast.models.items():
        samples = (
            np.reshape(step["models"][name]["samples"], (3, 5, 8, 2)).swapaxes(0, 1)
            / 100
        )
        assert_allclose(samples + forecast.observed[:, -1:], result.samples, atol=6e-3)
        assert step["models"][name]["central"] == result.central
    assert moments_of_stream["now"]["missing"] == {"7": "short", "9": "<script>"}
    assert (moments_of_stream["now"]["age"], step["score"]) == (
        now["age"],
        now["score"],
    )
    codes, alpha = moments.pairs.newest(forecast.observed)
    assert step["codes"] == [int(codes[pair]) for pair in ((0, 1), (0, 2), (1, 2))]
    assert_allclose(step["alpha"], alpha.ravel(), atol=6e-5)


def test_the_first_events_of_all_kinds_come_before_the_second_of_any(
    moments, stream, monkeypatch
):
    named = [
        ("meets", 0.9),
        ("meets", 0.8),
        ("follows", 0.7),
        ("meets", 0.6),
        ("follows", 0.6),
    ]
    events = [
        LikelyEvent(name, n, n + 1, share, 1.2) for n, (name, share) in enumerate(named)
    ]
    events.insert(
        2, LikelyEvent("follows", 1, 0, 0.75, 1.2)
    )  # of a pair that is told already
    monkeypatch.setattr(
        "neurosym_robot.dashboard.moments.likely_events", lambda *how: events
    )
    told = (json.loads(moments.moment(*event)) for event in stream(4, people=7))
    step = next(filter(None, (moment["step"] for moment in told)))
    likely = [(name, share) for name, _, _, share, _ in step["likely"]]
    assert likely == [named[n] for n in (0, 2, 1, 4, 3)]


@pytest.mark.slow
def test_symbols_and_weights_are_the_models_own():
    path = np.random.default_rng(0).normal(0, 0.2, (5, 8, 2)).cumsum(axis=1)
    config = Soft(learned=True)
    parameters = initial_parameters(config) | {"log_speed": np.float32(np.log(0.5))}
    generator = GeneratorConfig(pooling="as_described", weighting=config)
    models = {"SGAN": Model(GeneratorConfig(), {})}
    other = models | {"own": Model(generator, {"weighting": parameters})}
    codes, alpha = PairSymbols(other, 0.4).newest(path)
    states = observe(path[:, None], path, quantisation_factor=0.2)[:, :, -1]
    assert_array_equal(codes, (np.asarray(states) + 1) @ [27, 9, 3, 1])
    centred = path - path[:, -1].mean(axis=0)
    assert_allclose(alpha, config.alpha(parameters, centred)[..., -1], rtol=1e-4)
    assert PairSymbols(models, 0.4).newest(path)[1] is None


def test_time_never_falls(moments):
    nobody = np.zeros(0, np.int64), np.zeros((0, 2))
    idle: Any = SimpleNamespace(window=predictor().window, forecast=lambda focus: None)
    stamps = [100.0, 100.4, 100.4, 100.2, math.nan, math.inf, 101.0, 50.0, 50.4, 1e9]
    times = []
    for stamp in stamps:
        times.append(moments.moment(advance([Frame(stamp, *nobody)], idle), NOW))
    times = [json.loads(line)["t"] for line in times if line]
    assert times == pytest.approx([0, 0.4, 1.0, 61.0, 61.4, 1e9 - 50 + 61])


def test_whatever_is_seen_is_bounded_and_sound(moments):
    ids = np.arange(10_000)
    xy = np.full((10_000, 2), np.nan)
    xy[::2] = ids[::2, None] % 7
    xy[::4] = [np.inf, 1e300]
    now = {"missing": dict.fromkeys(ids.tolist(), "short"), "score": {}, "flows": None}
    moment = moments.moment(ReplayEvent(Frame(0.0, ids, xy), None), now)
    assert len(moment) < 100 * MAX_NAMED
    moment = json.loads(moment)
    assert len(moment["ids"]) == len(moment["now"]["missing"]) == MAX_NAMED
    assert moment["more"] == 2500 - MAX_NAMED
    assert moment["ids"][:2] == ["2", "6"]


YAML = "image: room.pgm\nresolution: 0.05\norigin: [-1.0, 2.5, 0.1]\n"
PIXELS = np.array([[0, 205, 254], [254, 100, 0]], np.uint8)


def opacity(row) -> np.ndarray:
    from PIL import Image

    data = base64.b64decode(row["image"].removeprefix("data:image/png;base64,"))
    return np.asarray(Image.open(io.BytesIO(data)))[..., 1]


@pytest.fixture
def room(tmp_path):
    pgm = b"P5\n# CREATOR: map_saver\n3 2\n255\n" + PIXELS.tobytes()
    (tmp_path / "room.pgm").write_bytes(pgm)
    (tmp_path / "room.yaml").write_text(YAML)
    return tmp_path / "room.yaml"


def test_walls_floor_and_the_unknown(room):
    floor = read_floor_map(room)
    assert (floor["width"], floor["height"]) == (0.15, 0.1)
    assert floor["origin"] == [-1.0, 2.5, 0.1]
    # As map_server reads it, 205 is (255 - 205) / 255 = 0.196 and so just not free.
    assert_array_equal(opacity(floor), [[255, UNKNOWN, 0], [0, UNKNOWN, 255]])
    room.write_text(YAML + "negate: 1\noccupied_thresh: 0.9\nfree_thresh: 0.1\n")
    assert_array_equal(
        opacity(read_floor_map(room)), [[0, UNKNOWN, 255], [255, UNKNOWN, 0]]
    )
