"""What is told of a forecast arrives whole, on ROS 1 and on ROS 2."""

import functools

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from neurosym_robot.online.pairs import LikelyEvents
from neurosym_robot.online.predictor import Forecast, ModelForecast
from neurosym_robot.ros.definitions import EVENTS, blank, typestore
from neurosym_robot.ros.outgoing import MARKERS, events_message, markers_message, samples_message

pytest.importorskip("rosbags", reason="rosbags is not installed")


@pytest.fixture(params=[1, 2], ids=["ros1", "ros2"], scope="module")
def store(request):
    return typestore(request.param)


@pytest.fixture(scope="module")
def forecast() -> Forecast:
    rng = np.random.default_rng(0)
    samples = 5e5 + rng.normal(size=(6, 2, 4, 2))
    observed = 5e5 + rng.normal(size=(2, 3, 2))
    result = ModelForecast(samples, samples.mean(axis=0), 3)
    ids, lost = np.array([4, -8]), np.array([0, 1])
    return Forecast(100.5, 9, ids, observed, {"SGAN": result}, {}, 0.0, lost)


def received(store, message):
    """What comes out at the other side."""
    kind = message.__msgtype__
    if "seq" in vars(blank(store, "std_msgs/msg/Header")):
        return store.deserialize_ros1(store.serialize_ros1(message, kind), kind)
    return store.deserialize_cdr(store.serialize_cdr(message, kind), kind)


def test_all_samples_compactly(store, forecast):
    new = functools.partial(blank, store)
    message = received(store, samples_message(new, forecast, "SGAN", 0.4, "map"))
    assert (message.model, message.period, message.central) == ("SGAN", 0.4, 3)
    assert (message.header.stamp.sec, message.header.frame_id) == (100, "map")
    assert_array_equal(message.ids, [4, -8])
    assert_array_equal(message.extrapolated, [0, 1])
    position = message.position.reshape(2, 2)
    futures = message.futures.reshape(message.samples, 2, message.steps, 2)
    # Far from the origin, too, to the hair's breadth.
    assert_allclose(position[:, None] + futures, forecast.models["SGAN"].samples, rtol=0, atol=1e-6)
    observed = forecast.observed
    walked = (observed[:, -1] - observed[:, -2]) / 0.4
    assert_allclose(message.velocity.reshape(2, 2), walked, rtol=1e-5)
    assert message.weights.sum() == pytest.approx(1)


def test_events_in_words_and_numbers(store, forecast):
    new = functools.partial(blank, store)
    message = received(store, events_message(new, forecast, "SGAN", 0.4, "map", 0.05))
    told = LikelyEvents(0.4, 0.05)(forecast, "SGAN")
    assert (message.__msgtype__, message.model, message.header.frame_id) == (EVENTS, "SGAN", "map")
    assert len(message.events) == len(told) > 0
    for event, each in zip(message.events, told):
        assert (event.name, event.words) == (each.name, each.words(forecast.ids))
        assert {event.k, event.l} == {4, -8}
        assert event.k == forecast.ids[each.k]
        assert_allclose([event.probability, event.seconds], each[3:], rtol=1e-6)
    assert received(store, events_message(new, forecast, "SGAN", 0.4, "map", 1.0)).events == []


def test_lines_for_rviz(store, forecast):
    message = markers_message(functools.partial(blank, store), forecast, "SGAN", 0.4, "map")
    assert message.__msgtype__ == MARKERS
    seen, lost = received(store, message).markers
    assert (seen.ns, seen.type, len(seen.points)) == ("SGAN/4", 4, 5)
    assert seen.color.a == 1 > lost.color.a > 0
    end = forecast.models["SGAN"].samples[3, 0, -1]
    assert_allclose([seen.points[-1].x, seen.points[-1].y], end)
