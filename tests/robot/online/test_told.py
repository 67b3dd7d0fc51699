"""What is told of a stream: its scores are offline ones, its age is honest, its events are all."""

import dataclasses
from collections import Counter
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose

from neurosym_jax.evaluation.scores import score
from neurosym_jax.symbolic import symbolic_events
from neurosym_jax.symbolic.events import EVENTS
from neurosym_robot.online.pairs import PAIRS, likely_events
from neurosym_robot.online.predictor import Forecast, ModelForecast
from neurosym_robot.online.replay import STRAIGHT, Analytics
from neurosym_robot.online.status import ARRIVALS, Status
from neurosym_robot.online.window import Window
from tests.robot.forecasts import made_forecast

K, OBS, PRED = 4, 3, 5


class Stream:
    """A predictor of random futures for people who walk, ten frames a second."""

    def __init__(self, length: int, people: int = 3):
        rng = np.random.default_rng(0)
        self.path = rng.normal(0, 0.1, (people, length, 2)).cumsum(axis=1)
        self.window = Window(OBS, 0.4, memory=0.4 * PRED + 1.0)
        programs = SimpleNamespace(add=lambda use: None)
        fake: Any = SimpleNamespace(
            window=self.window,
            seconds_ahead=0.4 * PRED,
            programs=programs,
            scales={},
            is_light=False,
        )
        self.analytics = Analytics(fake)
        self.done: list[Forecast] = []

    def push(self, n: int, ids, stamp: float | None = None) -> Forecast | None:
        """The forecast of frame n, in which `ids` are seen."""
        self.window.push(n / 10 if stamp is None else stamp, ids, self.path[ids, n])
        people, observed, lost, *_ = self.window.complete()
        forecast = None
        if len(people):
            samples = np.random.default_rng(n).normal(size=(K, len(people), PRED, 2))
            models = {
                "a": ModelForecast(samples, samples.mean(axis=0), 0, runtime=0.02)
            }
            missing = self.window.incomplete(people)
            forecast = made_forecast(
                observed,
                models,
                stamp=self.window.stamp,
                index=n,
                ids=people,
                dropped=missing,
                extrapolated=lost,
            )
        self.done += self.analytics.add(forecast)
        return forecast


def test_equals_the_offline_errors_of_one_forecast_a_period():
    stream = Stream(160)
    forecasts = [stream.push(n, [0, 1, 2]) for n in range(160)]
    stream.done += stream.analytics.finish()
    assert [forecast.index for forecast in stream.done] == list(range(8, 160, 4))
    scored = [forecast for forecast in stream.done if forecast.index + 4 * PRED < 160]
    for forecast in scored:
        truth = stream.path[:, forecast.index + 4 : forecast.index + 4 * PRED + 1 : 4]
        assert_allclose(forecast.future, truth, atol=1e-9)
    summary = stream.analytics.summary()
    assert (
        summary["forecasts"]
        == sum(forecast is not None for forecast in forecasts)
        == 152
    )
    result = summary["models"]["a"]
    assert (result["forecasts"], result["people"]) == (len(scored), 3 * len(scored))
    alone = [
        score(forecast.models["a"].samples, forecast.future) for forecast in scored
    ]
    for metric in alone[0]:
        expected = np.mean([scores[metric].mean for scores in alone], axis=0)
        assert result[metric] == pytest.approx(expected, rel=1e-6)
    # What is published is one forecast, the central one, and not the best by hindsight.
    errors = [forecast.models["a"].samples[0] - forecast.future for forecast in scored]
    off = np.linalg.norm(np.concatenate(errors), axis=-1)
    published = result["published_ade"], result["published_fde"]
    assert published == pytest.approx((off.mean(), off[:, -1].mean()))
    assert published[0] > result["joint_ade"]
    assert result["runtime"] == pytest.approx(20.0)
    # Beside them whoever goes on as before, once and not best of several.
    off = []
    for forecast in scored:
        last, before = forecast.observed[:, -1], forecast.observed[:, -2]
        for t in range(PRED):
            way = last + (t + 1) * (last - before)
            off.append(np.linalg.norm(way - forecast.future[:, t], axis=-1))
    result = summary["models"][STRAIGHT]
    assert result["joint_ade"] == pytest.approx(np.mean(off), rel=1e-5)
    assert stream.analytics.dropped["future unknown"] == 3 * (
        len(stream.done) - len(scored)
    )
    # Random futures of four samples hold what they should after recalibration.
    assert summary["models"]["a"]["coverage"]["90"] == pytest.approx(0.9, abs=0.1)
    assert summary["models"][STRAIGHT]["coverage"] == {}


def test_who_is_gone_is_not_scored_and_who_is_lost_for_a_moment_is():
    stream = Stream(120)
    for n in range(120):
        stream.push(n, [0] + [1] * (not 40 <= n < 46) + [2] * (n < 70))
    stream.done += stream.analytics.finish()
    people = {
        n: np.isfinite(item.future).all(axis=(1, 2))
        for n, item in enumerate(stream.done)
    }
    for n, item in enumerate(stream.done):
        ends = item.index + 4 * PRED
        expected = {0: ends < 120, 1: ends < 120, 2: ends < 70}
        assert {id: bool(k) for id, k in zip(item.ids.tolist(), people[n])} == {
            id: expected[id] for id in item.ids.tolist()
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


class Clocked:
    """A status, the lines that it reports, and a clock that is set by hand."""

    def __init__(self):
        self.now, self.said = 1000.0, []
        self.predictor: Any = SimpleNamespace(
            health=Counter(),
            window=SimpleNamespace(max_gap=1.0),
            dropped={},
            place=None,
        )
        self.summary: Any = {"forecasts": 0, "dropped": {}, "models": {}}
        analytics: Any = SimpleNamespace(summary=lambda: self.summary)
        report = self.said.append
        self.status = Status(
            self.predictor, analytics, report, 0.0, clock=lambda: self.now
        )

    def run(self, seconds: float, late: float) -> None:
        """Ten frames a second, each `late` when it comes."""
        for _ in range(round(10 * seconds)):
            self.now += 0.1
            self.status.heard(self.now - late)
            self.status.published(late + 0.005)
            self.status.look()


def test_a_stream_is_stale_by_its_age_and_says_when_it_is_back():
    stream = Clocked()
    stream.status.look()
    assert stream.status.stale  # Nothing came yet, which is no alarm.
    stream.run(5, late=0.02)
    assert not stream.status.stale
    assert stream.said == []
    assert stream.status.now()["p99"] == pytest.approx(25)
    stream.now += 3.0
    stream.status.look()
    stream.status.look()
    assert stream.said == ["stale: the newest people are 3.0 s old"]
    stream.run(0.1, late=0.02)
    assert stream.said[1:] == ["people again"]


def test_the_line_says_what_regions_held():
    means = {"people": 1, "published_ade": 0.3, "published_fde": 0.6, "joint_ade": 0.1}
    means |= {"joint_fde": 0.2, "coverage": {"50": 0.482, "90": 0.914}}
    stream = Clocked()
    stream.summary["models"]["m"] = means
    line = "50 % regions held 48 %, 90 % regions held 91 % in the last 5 minutes"
    assert line in stream.status.line()
    means["coverage"] = {}
    assert "regions" not in stream.status.line()


def test_a_growing_backlog_is_stale_though_frames_come():
    stream = Clocked()
    stream.run(5, late=0.02)
    for late in (0.4, 0.8, 1.2, 1.6, 2.0, 2.5):
        stream.run(1, late)
    assert stream.status.stale
    assert stream.status.offset == 0
    assert len(stream.said) == 1
    assert stream.status.now()["age"] == pytest.approx(2505)


@pytest.mark.parametrize(("late", "way"), [(30.0, "behind"), (-7.0, "ahead of")])
def test_a_constant_offset_is_told_and_not_called_stale(late, way):
    stream = Clocked()
    stream.run(ARRIVALS / 10, late)
    (line,) = stream.said
    assert (
        f"stamps are {abs(late):.1f} s {way} this computer's clock, constantly" in line
    )
    assert not stream.status.stale
    assert stream.status.offset == pytest.approx(late)
    assert f"of which {late:.1f} s are a constant offset" in stream.status.line()
    stream.now += 2.5
    assert stream.status.stale


def forecast_of(place, velocity, samples=20) -> Forecast:
    """People who go straight on, as the samples say but for 2 cm."""
    place, velocity = (
        np.asarray(vector, float)[:, None] for vector in (place, velocity)
    )
    steps = 0.4 * np.arange(-7, 9)[:, None]
    way = place + velocity * steps
    noise = np.random.default_rng(0).normal(0, 0.02, (samples, len(place), 8, 2))
    futures = way[:, 8:] + noise
    result = ModelForecast(futures, futures.mean(axis=0), 0)
    return made_forecast(way[:, :8], {"m": result}, ids=np.arange(len(place)) + 3)


def test_two_who_come_towards_each_other_pass():
    forecast = forecast_of([(0, 0), (4, 0.8)], [(1.2, 0), (-1.2, 0)])
    words = [event.words(forecast.ids) for event in likely_events(forecast, "m", 0.4)]
    # What is mutual is told once; 4, at the left of 3, has 3 at the left, too.
    assert "3 and 4 meet: 98 %, in 1.6 s" in words
    assert [text.split(":")[0] for text in sorted(words)] == [
        *("3 and 4 meet", "3 approaches 4", "3 passes with 4 on the left"),
        *("4 approaches 3", "4 passes with 3 on the left"),
    ]
    assert likely_events(forecast_of([(0, 0)], [(1, 0)]), "m", 0.4) == []


def test_an_event_is_as_probable_as_in_the_draws():
    meet = forecast_of([(0, 0), (4, 0.8)], [(1.2, 0), (-1.2, 0)])
    crossing = forecast_of([(0, 0), (4, 0.8)], [(-1.2, 0), (1.2, 0)])
    result = meet.models["m"]
    draws = np.concatenate([result.samples[:15], crossing.models["m"].samples[:5]])
    meet.models["m"] = dataclasses.replace(result, draw=lambda: draws)  # pyright: ignore
    events = {event.name: event.probability for event in likely_events(meet, "m", 0.4)}
    assert events["meets"] == pytest.approx(0.75, abs=0.06)


def test_the_list_is_that_of_all_pairs_and_bounded():
    rng = np.random.default_rng(1)
    for people in (5, 8):
        forecast = forecast_of(
            rng.uniform(-5, 5, (people, 2)) + 1e5, rng.normal(0, 1, (people, 2))
        )
        likely = likely_events(forecast, "m", 0.4, 0.3)
        events = symbolic_events(forecast.models["m"].samples, forecast.observed)
        share = dict(zip(EVENTS, np.asarray(events.probability)))
        seconds = dict(zip(EVENTS, np.asarray(events.seconds)[..., 1]))
        assert likely == sorted(likely, key=lambda event: -event.probability)
        for name, *pair, probability, when in likely:
            assert probability == pytest.approx(share[name][tuple(pair)], abs=1e-6)
            assert when == pytest.approx(seconds[name][tuple(pair)])
        pairs = {frozenset(event[1:3]) for event in likely}
        assert len(pairs) <= PAIRS
        if people == 5:
            once = [
                np.triu(table) if EVENTS[name].mutual else table
                for name, table in share.items()
            ]
            assert len(likely) == (np.array(once) >= 0.3).sum() > 2
