"""What others are told of a forecast is what it says."""

import dataclasses
import functools

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from neurosym_jax.errors import InputError
from neurosym_robot.online.predictor import Forecast, ModelForecast
from neurosym_robot.ros.definitions import HUMANS, blank, typestore
from neurosym_robot.ros.people import seconds_of, see
from neurosym_robot.ros.trajectories import forecast_message, truth_message

pytest.importorskip("rosbags", reason="rosbags is not installed")

STEPS = 100 + 0.4 * np.arange(-2, 5)


@pytest.fixture(scope="module")
def new():
    return functools.partial(blank, typestore(1))


def forecast() -> Forecast:
    rng = np.random.default_rng(0)
    samples = rng.normal(size=(6, 2, 4, 2))
    result = ModelForecast(samples, samples.mean(axis=0), 3)
    observed = rng.normal(size=(2, 3, 2))
    return Forecast(
        100.0, 9, np.array([4, 8]), observed, {"SGAN": result}, {}, 0.0, np.array([0, 1])
    )


def test_a_forecast_is_the_observed_and_the_most_central_future(new):
    there = forecast()
    message = forecast_message(new, there, "SGAN", 0.4, "odom")
    frames = [see(HUMANS, step) for step in message.trajs]
    assert seconds_of(message.header.stamp) == 100.0
    assert message.header.frame_id == "odom"
    assert_allclose([frame.stamp for frame in frames], STEPS)
    whole = np.concatenate([there.observed, there.models["SGAN"].samples[3]], axis=1)
    for n, frame in enumerate(frames):
        assert frame.ids.tolist() == [4, 8]
        assert_array_equal(frame.xy, whole[:, n])
    covariance = message.trajs[6].humans[1].centroid.covariance.reshape(6, 6)
    samples = there.models["SGAN"].samples[:, 1, 3]
    assert_allclose(covariance[:2, :2], np.cov(samples.T, bias=True))
    assert [human.confidence for human in message.trajs[6].humans] == [1, pytest.approx(2 / 3)]
    assert not message.trajs[2].humans[1].centroid.covariance.any()


def test_the_truth_is_of_those_seen_to_the_end(new):
    future = np.random.default_rng(1).normal(size=(2, 4, 2))
    future[0, 3] = np.nan
    there = dataclasses.replace(forecast(), future=future)
    message = truth_message(new, there, 0.4)
    frames = [see(HUMANS, step) for step in message.trajs]
    assert seconds_of(message.header.stamp) == 100.0
    assert [frame.ids.tolist() for frame in frames] == [[8]] * 7
    assert_array_equal(np.stack([frame.xy[0] for frame in frames[3:]]), future[1])
    nobody = dataclasses.replace(there, future=np.full_like(future, np.nan))
    assert truth_message(new, nobody, 0.4) is None
    with pytest.raises(InputError, match="not known yet"):
        truth_message(new, forecast(), 0.4)
