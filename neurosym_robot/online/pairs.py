"""Probable events of the pairs of a forecast that come nearest to each other.

They are computed only when asked for: by the page, a topic with subscribers, a file.
`symbolic.events` defines the events, `symbolic.forecast` turns samples into probabilities.
"""

from typing import NamedTuple

import numpy as np

from neurosym_jax.errors import InputError
from neurosym_jax.symbolic.events import EVENTS
from neurosym_jax.symbolic.forecast import EventForecast, symbolic_events
from neurosym_robot.online.predictor import Forecast, Predictor

__all__ = ["AT_LEAST", "LikelyEvent", "LikelyEvents"]

AT_LEAST = 0.5  # least probability of an event that is listed
PAIRS = 16  # pairs that are looked at: those whose mean paths come nearest to each other


class LikelyEvent(NamedTuple):
    """A probable event of the pair k, l."""

    name: str  # of `symbolic.events`
    k: int  # row of the subject among the forecast's people
    l: int  # noqa: E741, row of the other; the calculus calls the two k and l
    probability: float
    seconds: float  # from the last step observed to the event, median over samples that have it

    def words(self, ids: np.ndarray) -> str:
        """Such as `3 follows 5: 80 %, in 1.2 s`; `ids` [N] of the people."""
        what = EVENTS[self.name].in_short(self.name).format(k=ids[self.k], l=ids[self.l])
        return f"{what}: {100 * self.probability:.0f} %, in {self.seconds:.1f} s"


class LikelyEvents:
    """Lists the probable events of a forecast, by one program for any number of people."""

    def __init__(self, period: float, at_least: float = AT_LEAST):
        """Nothing is compiled yet.

        Args:
            period: seconds between the models' steps.
            at_least: least probability of an event that is listed.

        Raises:
            InputError: for a probability outside (0, 1].
        """
        if not 0 < at_least <= 1:
            raise InputError(f"events are told from a probability in (0, 1] on, not {at_least:g}")
        self._period, self._at_least = period, at_least

    @classmethod
    def of(cls, predictor: Predictor, at_least: float = AT_LEAST) -> "LikelyEvents":
        """The list for forecasts of `predictor`, compiled with its programs."""
        found = cls(predictor.window.period, at_least)

        def compile(size: int) -> None:
            for steps in {model.config.pred_len for model in predictor.models.values()}:
                for count in predictor.samples:
                    samples = np.zeros((count, 4 * PAIRS, steps, 2))
                    found._events(samples, samples[0, :, :1])

        predictor.programs.add(compile, predictor.programs.sizes[:1])
        return found

    def __call__(self, forecast: Forecast, model: str) -> list[LikelyEvent]:
        """Events of the nearest pairs, most probable first."""
        result = forecast.models[model]
        near = nearest_pairs(result.mean)
        if not len(near):
            return []
        # Both directions of a pair; always as many, so that one program serves all.
        pairs = np.resize(np.concatenate([near, near[:, ::-1]]), (2 * PAIRS, 2))
        ends = pairs.T.ravel()
        found = self._events(result.samples[:, ends], forecast.observed[ends, -1:])
        share, seconds = np.asarray(found.probability), np.asarray(found.seconds)[..., 1]
        names, listed = tuple(EVENTS), []
        for event, row in np.argwhere(share[:, : 2 * len(near)] >= self._at_least).tolist():
            # A mutual event has the same probability in both directions, and is listed once.
            once = row < len(near) or not EVENTS[names[event]].mutual
            if once and np.isfinite(seconds[event, row]):
                at = float(share[event, row]), float(seconds[event, row])
                k, l = pairs[row].tolist()  # noqa: E741
                listed.append(LikelyEvent(names[event], k, l, *at))
        return sorted(listed, key=lambda each: (-each.probability, each.seconds))

    def _events(self, samples: np.ndarray, last: np.ndarray) -> EventForecast:
        # The first half of the paths in `samples [k, 2 P, T, 2]` with the second.
        pairs = np.arange(samples.shape[1]).reshape(2, -1).T
        return symbolic_events(
            samples, last, events=tuple(EVENTS), pairs=pairs, period=self._period
        )


def nearest_pairs(mean: np.ndarray) -> np.ndarray:
    """[P, 2] the pairs i < j whose paths [N, T, 2] come nearest to each other, nearest first."""
    i, j = np.triu_indices(len(mean), 1)
    least = np.square(mean[i] - mean[j]).sum(axis=-1).min(axis=-1)
    order = np.argsort(least, kind="stable")[:PAIRS]
    return np.stack([i[order], j[order]], axis=1)
