"""Running errors of online forecasts, scored as the future arrives; the same live and in a replay.

The truth is what later forecasts observed, so nothing but `Forecast`s is needed. Only people whose
whole future was observed are scored; the others are counted with the reason. What is kept are
sums, and the forecasts of one horizon.
"""

import collections
import dataclasses
from typing import Any

import numpy as np

from neurosym_jax.errors import InputError
from neurosym_jax.evaluation.metrics import scene_errors
from neurosym_jax.online.predictor import Forecast

__all__ = ["Analytics", "Score"]

LATENCIES = 4096
"""The newest so many are kept for the percentiles."""
PERCENTILES = (50, 90, 99)


@dataclasses.dataclass
class Score:
    """Sums over the people scored of one model, metres; see `evaluation.metrics.SceneErrors`."""

    horizon_sum: np.ndarray
    """[pred_len] metres."""
    forecasts: int = 0
    """With at least one person whose future is known."""
    people: float = 0.0
    joint_ade_sum: float = 0.0
    joint_fde_sum: float = 0.0
    marginal_ade_sum: float = 0.0
    marginal_fde_sum: float = 0.0

    def means(self) -> dict[str, Any]:
        """Errors in metres, means over people, None before the first; JSON-able."""

        def mean(value: float) -> float | None:
            return value / self.people if self.people else None

        return {
            "forecasts": self.forecasts,
            "people": int(self.people),
            "joint_ade": mean(self.joint_ade_sum),
            "joint_fde": mean(self.joint_fde_sum),
            "marginal_ade": mean(self.marginal_ade_sum),
            "marginal_fde": mean(self.marginal_fde_sum),
            "horizon": [mean(value) for value in self.horizon_sum.tolist()],
        }


class Analytics:
    """The running score of every model of a stream of forecasts."""

    def __init__(self, grace: int = 2):
        """Nothing scored yet.

        Args:
            grace: steps that a forecast waits beyond its horizon, so that a person who was lost
                for a moment at its end is there again.

        Raises:
            InputError: for a negative grace.
        """
        if grace < 0:
            raise InputError(f"grace must not be negative, not {grace}")
        self.grace = grace
        self.scores: dict[str, Score] = {}
        self.forecasts = 0
        self.dropped: collections.Counter[str] = collections.Counter()
        """People without a forecast by reason, once for each forecast that they are missing in;
        and people with one that cannot be scored: "future unknown"."""
        self._latency: collections.deque[float] = collections.deque(maxlen=LATENCIES)
        self._pending: collections.deque[Forecast] = collections.deque()
        self._truth: dict[int, dict[int, np.ndarray]] = {}

    def add(self, forecast: Forecast) -> list[Forecast]:
        """Take in the next forecast; those that it made ready, scored, with their `future`."""
        done: list[Forecast] = []
        if self._pending and forecast.index <= self._pending[-1].index:
            # The clock was set back: the future of those before it never comes.
            done = self.finish()
        self.forecasts += 1
        self.dropped.update(forecast.dropped.values())
        self._latency.append(forecast.latency)
        self._learn(forecast)
        self._pending.append(forecast)
        while forecast.index >= self._pending[0].index + _horizon(self._pending[0]) + self.grace:
            done.append(self._score(self._pending.popleft()))
            # What is pending looks at steps after its own only.
            first = self._pending[0].index if self._pending else forecast.index
            self._truth = {step: at for step, at in self._truth.items() if step > first}
        return done

    def finish(self) -> list[Forecast]:
        """At the end of a recording: score what waits and can be scored; with their `future`."""
        done = [self._score(forecast) for forecast in self._pending]
        self._pending.clear()
        self._truth.clear()
        return done

    def summary(self) -> dict[str, Any]:
        """Everything so far, JSON-able: counts, means in metres, latencies in milliseconds."""
        latency = [None] * len(PERCENTILES)
        if self._latency:
            latency = np.percentile(1e3 * np.array(self._latency), PERCENTILES).tolist()
        return {
            "forecasts": self.forecasts,
            "pending": len(self._pending),
            "dropped": dict(self.dropped),
            "latency_ms": {f"p{p}": value for p, value in zip(PERCENTILES, latency)},
            "models": {name: score.means() for name, score in self.scores.items()},
        }

    def _learn(self, forecast: Forecast) -> None:
        """Remember what it observed since the oldest forecast that waits."""
        oldest = self._pending[0].index if self._pending else forecast.index
        steps = forecast.observed.shape[1]
        for n in range(max(forecast.index - steps + 1, oldest + 1), forecast.index + 1):
            seen = forecast.extrapolated <= forecast.index - n
            column = forecast.observed[seen, n - forecast.index - 1]
            self._truth.setdefault(n, {}).update(zip(forecast.ids[seen].tolist(), column))

    def _score(self, forecast: Forecast) -> Forecast:
        ids = forecast.ids.tolist()
        future = np.full((len(ids), _horizon(forecast), 2), np.nan)
        for step in range(future.shape[1]):
            seen = self._truth.get(forecast.index + 1 + step, {})
            for n, id in enumerate(ids):
                future[n, step] = seen.get(id, np.nan)
        known = np.all(np.isfinite(future), axis=2)
        for name, result in forecast.models.items():
            length = result.mean.shape[1]
            score = self.scores.setdefault(name, Score(np.zeros(length)))
            rows = np.flatnonzero(np.all(known[:, :length], axis=1))
            if not len(rows):
                continue
            errors = scene_errors(
                result.samples[:, rows], future[rows, :length], np.array([len(rows)])
            )
            score.forecasts += 1
            score.people += len(rows)
            score.joint_ade_sum += float(errors.joint_ade[0])
            score.joint_fde_sum += float(errors.joint_fde[0])
            score.marginal_ade_sum += float(errors.marginal_ade[0])
            score.marginal_fde_sum += float(errors.marginal_fde[0])
            score.horizon_sum += errors.horizon[0]
        unknown = len(ids) - int(np.all(known, axis=1).sum())
        if unknown:
            self.dropped["future unknown"] += unknown
        return dataclasses.replace(forecast, future=future)


def _horizon(forecast: Forecast) -> int:
    return max(result.mean.shape[1] for result in forecast.models.values())
