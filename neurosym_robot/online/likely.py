"""The events of pairs that a forecast makes probable, as a short list.

What the events are is `symbolic.events`', and how samples become probabilities is
`symbolic.forecast`'s. Nothing is computed with the forecast itself, but for whoever asks: the page,
a topic that somebody hears, a file.
"""

from typing import NamedTuple

import numpy as np

from neurosym_jax.errors import InputError
from neurosym_jax.symbolic.events import EVENTS, in_short
from neurosym_jax.symbolic.forecast import EventForecast, symbolic_events
from neurosym_robot.online.predictor import Forecast, Predictor

__all__ = ["AT_LEAST", "PAIRS", "LikelyEvent", "LikelyEvents", "nearest_pairs"]

AT_LEAST = 0.5
"""Probability from which on an event is told."""
PAIRS = 16
"""Pairs that are looked at: those whose mean ways come nearest to each other."""


class LikelyEvent(NamedTuple):
    """Something that k and l will probably do."""

    name: str
    """Of `symbolic.events`."""
    k: int
    """Row of who does it among the forecast's people."""
    l: int  # noqa: E741 (the calculus calls the two k and l)
    """Row of the other."""
    probability: float
    seconds: float
    """From the last step observed to the first happening: the median over samples that have it."""

    def words(self, ids: np.ndarray) -> str:
        """Such as `3 follows 5: 80 %, in 1.2 s`; `ids` [N] of the people."""
        what = in_short(self.name).format(k=ids[self.k], l=ids[self.l])
        return f"{what}: {100 * self.probability:.0f} %, in {self.seconds:.1f} s"


class LikelyEvents:
    """From a forecast to the list, most probable first; one program for any number of people."""

    def __init__(self, period: float, at_least: float = AT_LEAST):
        """Nothing is compiled yet.

        Args:
            period: seconds between the models' steps.
            at_least: the probability from which on an event is told.

        Raises:
            InputError: for a probability that is none.
        """
        if not 0 < at_least <= 1:
            raise InputError(f"events are told from a probability in (0, 1] on, not {at_least:g}")
        self._period, self._at_least = period, at_least

    @classmethod
    def of(cls, predictor: Predictor, at_least: float = AT_LEAST) -> "LikelyEvents":
        """The list of what `predictor` forecasts, compiled with its programs."""
        lengths = {model.config.pred_len for model in predictor.models.values()}

        def compile(size: int) -> None:
            for steps in lengths:
                for count in predictor.samples:
                    ways = np.zeros((count, 4 * PAIRS, steps, 2))
                    _events(ways, ways[0, :, :1], tuple(EVENTS), predictor.window.period)

        predictor.programs.add(compile, predictor.programs.sizes[:1])
        return cls(predictor.window.period, at_least)

    def __call__(self, forecast: Forecast, model: str) -> list[LikelyEvent]:
        """What `model` makes of the pairs that come nearest to each other."""
        result = forecast.models[model]
        near = nearest_pairs(result.mean)
        if not len(near):
            return []
        # Both ways round; always as many, so that one program serves all.
        pairs = np.resize(np.concatenate([near, near[:, ::-1]]), (2 * PAIRS, 2))
        ends = pairs.T.ravel()
        names = tuple(EVENTS)
        last = forecast.observed[ends, -1:]
        found = _events(result.samples[:, ends], last, names, self._period)
        count = 2 * len(near)
        share, seconds = np.asarray(found.probability), np.asarray(found.seconds)[..., 1]
        told = []
        for event, row in np.argwhere(share[:, :count] >= self._at_least).tolist():
            # What is mutual happens to both ways round alike, and is told once.
            once = row < len(near) or not EVENTS[names[event]].mutual
            if once and np.isfinite(seconds[event, row]):
                k, l = pairs[row].tolist()  # noqa: E741
                at = float(share[event, row]), float(seconds[event, row])
                told.append(LikelyEvent(names[event], k, l, *at))
        return sorted(told, key=lambda each: (-each.probability, each.seconds))


def _events(
    samples: np.ndarray, last: np.ndarray, names: tuple[str, ...], period: float
) -> EventForecast:
    """Of those in the first half of `samples [k, 4 PAIRS, T, 2]` with those in the second."""
    pairs = np.arange(4 * PAIRS).reshape(2, -1).T
    return symbolic_events(samples, last, events=names, pairs=pairs, period=period)


def nearest_pairs(mean: np.ndarray) -> np.ndarray:
    """[P, 2] the pairs i < j whose ways [N, T, 2] come nearest to each other, nearest first."""
    i, j = np.triu_indices(len(mean), 1)
    least = np.square(mean[i] - mean[j]).sum(axis=-1).min(axis=-1)
    order = np.argsort(least, kind="stable")[:PAIRS]
    return np.stack([i[order], j[order]], axis=1)
