"""The list of probable events is that of all pairs, for whoever they are and however many."""

import numpy as np
import pytest

from neurosym_jax.symbolic import symbolic_events
from neurosym_jax.symbolic.events import EVENTS
from neurosym_robot.online.pairs import PAIRS, likely_events
from neurosym_robot.online.predictor import Forecast, ModelForecast


def forecast_of(place, velocity, samples=20) -> Forecast:
    """People who go straight on, as the samples say but for 2 cm."""
    place, velocity = (np.asarray(each, float)[:, None] for each in (place, velocity))
    steps = 0.4 * np.arange(-7, 9)[:, None]
    way = place + velocity * steps
    noise = np.random.default_rng(0).normal(0, 0.02, (samples, len(place), 8, 2))
    futures = way[:, 8:] + noise
    result = ModelForecast(futures, futures.mean(axis=0), 0)
    count = len(place)
    return Forecast(
        0.0, 0, np.arange(count) + 3, way[:, :8], {"m": result}, {}, 0.0, np.zeros(count, int)
    )


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


def test_the_list_is_that_of_all_pairs_and_bounded():
    rng = np.random.default_rng(1)
    for people in (5, 40):
        forecast = forecast_of(rng.uniform(-5, 5, (people, 2)) + 1e5, rng.normal(0, 1, (people, 2)))
        told = likely_events(forecast, "m", 0.4, 0.3)
        found = symbolic_events(forecast.models["m"].samples, forecast.observed)
        share = dict(zip(EVENTS, np.asarray(found.probability)))
        seconds = dict(zip(EVENTS, np.asarray(found.seconds)[..., 1]))
        assert told == sorted(told, key=lambda each: -each.probability)
        for name, *pair, probability, when in told:
            assert probability == pytest.approx(share[name][tuple(pair)], abs=1e-6)
            assert when == pytest.approx(seconds[name][tuple(pair)])
        pairs = {frozenset(each[1:3]) for each in told}
        assert len(pairs) <= PAIRS
        if people == 5:
            once = [np.triu(each) if EVENTS[name].mutual else each for name, each in share.items()]
            assert len(told) == (np.array(once) >= 0.3).sum() > 2
