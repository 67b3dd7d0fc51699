"""Running errors of online forecasts, scored as the future arrives; the same live and in a replay.

One forecast a period is scored, against what the predictor's window has seen since. Only people
whose whole future was observed are scored; the others are counted with the reason.
"""

import collections
import dataclasses
from typing import Any

import numpy as np

from neurosym_jax.data.tracks import SNAP
from neurosym_jax.evaluation.metrics import metric_names
from neurosym_jax.evaluation.scoring import score
from neurosym_robot.online.predictor import GRACE, Forecast, Predictor

__all__ = ["STRAIGHT", "Analytics", "straight"]

STRAIGHT = "constant velocity"  # scored beside the models, as a baseline


class Analytics:
    """Running scores of the models of a predictor's forecasts, and of `STRAIGHT`."""

    def __init__(self, predictor: Predictor):
        """Compile the scores with the programs of `predictor`."""
        self.forecasts = 0
        self.dropped: collections.Counter[str] = collections.Counter()
        """People without a forecast by reason, once for each forecast that they are missing in;
        and people with a forecast that cannot be scored: "future unknown"."""
        self._sums: dict[str, dict[str, Any]] = {}
        """Of each model: forecasts and people scored, and [2, ...] total and count of metrics."""
        self._window = predictor.window
        self._wait = predictor.seconds_ahead + GRACE
        self._pending: collections.deque[Forecast] = collections.deque()
        lengths = {model.config.pred_len for model in predictor.models.values()}

        def compile(size: int) -> None:
            for length in lengths:
                future = np.zeros((size, length, 2))
                for samples in predictor.samples:
                    score(np.zeros((samples, *future.shape)), future)

        predictor.programs.add(compile)

    def add(self, forecast: Forecast | None) -> list[Forecast]:
        """Take in what the newest frame brought; return the forecasts that it completed.

        One forecast a period is followed, and returned with its `future`.
        """
        done = []
        if self._pending and self._window.stamp < self._pending[-1].stamp:
            done = self.finish()  # The clock was set back: their future never comes.
        while self._pending and self._window.stamp >= self._pending[0].stamp + self._wait:
            done.append(self._score(self._pending.popleft()))
        if forecast is not None:
            self.forecasts += 1
            self.dropped.update(forecast.dropped.values())
            newest = self._pending[-1].stamp if self._pending else -np.inf
            if forecast.stamp - newest >= self._window.period - SNAP:
                self._pending.append(forecast)
        return done

    def finish(self) -> list[Forecast]:
        """At the end of a recording, score the forecasts that wait, and return them."""
        done = [self._score(forecast) for forecast in self._pending]
        self._pending.clear()
        return done

    def summary(self) -> dict[str, Any]:
        """JSON-able counts, and means in metres or None before the first."""
        models = {}
        for name, sums in self._sums.items():
            models[name] = {"forecasts": sums["forecasts"], "people": sums["people"]}
            for metric in metric_names():
                total, count = sums.get(metric, np.zeros(2))
                models[name][metric] = (total / count).tolist() if count.any() else None
        return {
            "forecasts": self.forecasts,
            "pending": len(self._pending),
            "dropped": dict(self.dropped),
            "models": models,
        }

    def _score(self, forecast: Forecast) -> Forecast:
        steps = max(result.mean.shape[1] for result in forecast.models.values())
        times = forecast.stamp + self._window.period * np.arange(1, steps + 1)
        future = self._window.resampled(forecast.ids, times)
        known: Any = np.isfinite(future).all(axis=2)
        samples = {name: result.samples for name, result in forecast.models.items()}
        # As many as a model's, all alike, so that the same program scores them.
        going_on = straight(forecast.observed, steps)
        samples[STRAIGHT] = np.repeat(going_on[None], len(next(iter(samples.values()))), axis=0)
        for name, each in samples.items():
            length = each.shape[2]
            sums = self._sums.setdefault(name, {"forecasts": 0, "people": 0})
            there = known[:, :length].all(axis=1)
            found = score(each, future[:, :length], there) if there.any() else {}
            new: dict[str, Any] = {"forecasts": int(there.any()), "people": int(there.sum())}
            for metric, one in found.items():
                both = np.stack(np.broadcast_arrays(one.total[0], one.count[0]))
                new[metric] = both.astype(np.float64)
            sums |= {metric: sums.get(metric, 0) + value for metric, value in new.items()}
        unknown = int((~known.all(axis=1)).sum())
        self.dropped.update({"future unknown": unknown} if unknown else {})
        return dataclasses.replace(forecast, future=future)


def straight(observed: np.ndarray, steps: int) -> np.ndarray:
    """[N, steps, 2] of people `observed` [N, T, 2] who go on as between their last two steps."""
    step = np.diff(observed[:, -2:], axis=1).sum(axis=1, keepdims=True)
    return observed[:, -1:] + np.arange(1, steps + 1)[:, None] * step
