"""The running score is the offline score of the same forecasts, and stays small."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose

from neurosym_jax.evaluation.scoring import score
from neurosym_robot.online.analytics import STRAIGHT, Analytics
from neurosym_robot.online.predictor import Forecast, ModelForecast
from neurosym_robot.online.window import Window

K, OBS, PRED = 4, 3, 5


class Stream:
    """A predictor of random futures for people who walk, ten frames a second."""

    def __init__(self, length: int, people: int = 3):
        rng = np.random.default_rng(0)
        self.path = rng.normal(0, 0.1, (people, length, 2)).cumsum(axis=1)
        self.window = Window(OBS, 0.4, memory=0.4 * PRED + 1.0)
        config = SimpleNamespace(pred_len=PRED)
        fake: Any = SimpleNamespace(
            window=self.window,
            seconds_ahead=0.4 * PRED,
            models={"a": SimpleNamespace(config=config)},
            samples={K},
            programs=SimpleNamespace(add=lambda compile: None),
        )
        self.analytics = Analytics(fake)
        self.done: list[Forecast] = []

    def push(self, n: int, ids, stamp: float | None = None) -> Forecast | None:
        """The forecast of frame n, in which `ids` are seen."""
        self.window.push(n / 10 if stamp is None else stamp, ids, self.path[ids, n])
        people, observed, lost = self.window.complete()
        each = None
        if len(people):
            samples = np.random.default_rng(n).normal(size=(K, len(people), PRED, 2))
            models = {"a": ModelForecast(samples, samples.mean(axis=0), 0)}
            missing = self.window.incomplete(people)
            each = Forecast(self.window.stamp, n, people, observed, models, missing, 1e-3, lost)
        self.done += self.analytics.add(each)
        return each


def test_equals_the_offline_errors_of_one_forecast_a_period():
    stream = Stream(160)
    forecasts = [stream.push(n, [0, 1, 2]) for n in range(160)]
    stream.done += stream.analytics.finish()
    assert [each.index for each in stream.done] == list(range(8, 160, 4))
    scored = [each for each in stream.done if each.index + 4 * PRED < 160]
    for each in scored:
        truth = stream.path[:, each.index + 4 : each.index + 4 * PRED + 1 : 4]
        assert_allclose(each.future, truth, atol=1e-9)
    summary = stream.analytics.summary()
    assert summary["forecasts"] == sum(each is not None for each in forecasts) == 152
    result = summary["models"]["a"]
    assert (result["forecasts"], result["people"]) == (len(scored), 3 * len(scored))
    alone = [score(each.models["a"].samples, each.future) for each in scored]
    for metric in alone[0]:
        expected = np.mean([each[metric].mean for each in alone], axis=0)
        assert result[metric] == pytest.approx(expected, rel=1e-6)
    # Beside them whoever goes on as before, once and not best of several.
    off = []
    for each in scored:
        last, before = each.observed[:, -1], each.observed[:, -2]
        for t in range(PRED):
            way = last + (t + 1) * (last - before)
            off.append(np.linalg.norm(way - each.future[:, t], axis=-1))
    result = summary["models"][STRAIGHT]
    assert result["joint_ade"] == pytest.approx(np.mean(off), rel=1e-5)
    assert stream.analytics.dropped["future unknown"] == 3 * (len(stream.done) - len(scored))


def test_who_is_gone_is_not_scored_and_who_is_lost_for_a_moment_is():
    stream = Stream(120)
    for n in range(120):
        stream.push(n, [0] + [1] * (not 40 <= n < 46) + [2] * (n < 70))
    stream.done += stream.analytics.finish()
    known = {n: np.isfinite(each.future).all(axis=(1, 2)) for n, each in enumerate(stream.done)}
    for n, each in enumerate(stream.done):
        ends = each.index + 4 * PRED
        wanted = {0: ends < 120, 1: ends < 120, 2: ends < 70}
        assert {id: bool(k) for id, k in zip(each.ids.tolist(), known[n])} == {
            id: wanted[id] for id in each.ids.tolist()
        }
    assert stream.analytics.dropped["unseen"] > 0


def test_a_clock_set_back_ends_what_waits_and_memory_is_bounded():
    stream = Stream(400)
    for n in range(200):
        stream.push(n, [0, 1])
        assert len(stream.analytics._pending) <= (PRED * 0.4 + 1.0) / 0.4 + 1
    pending = len(stream.analytics._pending)
    before = len(stream.done)
    stream.push(200, [0, 1], stamp=-1000.0)
    assert len(stream.done) == before + pending
    assert np.isnan(stream.done[-1].future).all()
    assert stream.analytics.summary()["pending"] == 0
