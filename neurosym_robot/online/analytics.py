"""Running errors of online forecasts, scored as the future arrives; the same live and in a replay.

The truth is what later forecasts observed. Only people whose whole future was observed are scored;
the others are counted with the reason.
"""

import collections
import dataclasses
from collections.abc import Collection, Mapping
from typing import Any

import numpy as np

from neurosym_jax.evaluation.metrics import metric_names
from neurosym_jax.evaluation.scene_score import score
from neurosym_jax.evaluation.scoring import Scores
from neurosym_robot.online.predictor import Forecast, Predictor

__all__ = ["STRAIGHT", "Analytics", "RunningScore", "straight"]

STRAIGHT = "constant velocity"  # scored beside the models, as a baseline
GRACE = 2  # steps waited beyond the horizon, for people lost for a moment at its end
LATENCIES = 4096  # newest latencies kept for the percentiles
PERCENTILES = (50, 90, 99)
RECENT = 150  # forecasts in the sliding window: a minute of them


@dataclasses.dataclass
class RunningScore:
    """Sums of the metrics of one model."""

    forecasts: int = 0  # with at least one person whose future is known
    people: int = 0
    # total [] or [pred_len] and count of each metric
    sums: dict[str, tuple[np.ndarray, float]] = dataclasses.field(default_factory=dict)
    newest: collections.deque[tuple[Scores, int]] = dataclasses.field(
        default_factory=lambda: collections.deque(maxlen=RECENT)
    )

    def recent(self) -> "RunningScore":
        """The score of the newest forecasts alone."""
        score = RunningScore()
        for scores, people in self.newest:
            score.add(scores, people)
        return score

    def add(self, scores: Scores, people: int) -> None:
        """Add the scores of one forecast of `people` people."""
        self.newest.append((scores, people))
        self.forecasts += 1
        self.people += people
        for name, each in scores.items():
            total, count = self.sums.get(name, (np.zeros(each.total.shape[1:]), 0.0))
            self.sums[name] = total + each.total[0], count + float(each.count[0])

    def means(self) -> dict[str, Any]:
        """JSON-able means of the metrics; None before the first."""
        means: dict[str, Any] = dict.fromkeys(metric_names())
        for name, (total, count) in self.sums.items():
            means[name] = (total / count).tolist() if count else None
        return {"forecasts": self.forecasts, "people": self.people, **means}


class Analytics:
    """Running scores of the models of a stream of forecasts."""

    def __init__(self):
        self.scores: dict[str, RunningScore] = {}
        """By name of the model, and of `STRAIGHT`."""
        self.forecasts = 0
        self.dropped: collections.Counter[str] = collections.Counter()
        """People without a forecast by reason, once for each forecast that they are missing in;
        and people with one that cannot be scored: "future unknown"."""
        self._latency: collections.deque[float] = collections.deque(maxlen=LATENCIES)
        self._pending: collections.deque[Forecast] = collections.deque()
        self._truth: dict[int, dict[int, np.ndarray]] = {}

    @classmethod
    def of(cls, predictor: Predictor) -> "Analytics":
        """Analytics whose programs are compiled with those of `predictor`."""
        lengths = {model.config.pred_len for model in predictor.models.values()}

        def compile(size: int) -> None:
            for length in lengths:
                future = np.zeros((size, length, 2))
                for samples in predictor.samples:
                    score(np.zeros((samples, *future.shape)), future)

        predictor.programs.add(compile)
        return cls()

    def add(self, forecast: Forecast) -> list[Forecast]:
        """Take in the next forecast; return those that it completed, with their `future`."""
        done: list[Forecast] = []
        if self._pending and forecast.index <= self._pending[-1].index:
            # The clock was set back: the future of those before it never comes.
            done = self.finish()
        self.forecasts += 1
        self.dropped.update(forecast.dropped.values())
        self._latency.append(forecast.latency)
        self._learn(forecast)
        self._pending.append(forecast)
        while forecast.index >= self._pending[0].index + _horizon(self._pending[0]) + GRACE:
            done.append(self._score(self._pending.popleft()))
            # Forecasts that wait need steps after their own only.
            first = self._pending[0].index if self._pending else forecast.index
            self._truth = {step: at for step, at in self._truth.items() if step > first}
        return done

    def finish(self) -> list[Forecast]:
        """At the end of a recording, score the forecasts that wait, and return them."""
        done = [self._score(forecast) for forecast in self._pending]
        self._pending.clear()
        self._truth.clear()
        return done

    def summary(self) -> dict[str, Any]:
        """JSON-able counts, means in metres and latencies in milliseconds.

        "recent" has forecasts, latencies and models of the last minute alone.
        """
        recent = {name: score.recent() for name, score in self.scores.items()}
        return {
            "forecasts": self.forecasts,
            "pending": len(self._pending),
            "dropped": dict(self.dropped),
            **_so_far(self._latency, self.scores),
            "recent": {
                "forecasts": min(self.forecasts, RECENT),
                **_so_far(list(self._latency)[-RECENT:], recent),
            },
        }

    def _learn(self, forecast: Forecast) -> None:
        """Remember positions observed since the oldest forecast that waits."""
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
        samples = {name: result.samples for name, result in forecast.models.items()}
        # As many as a model's, all alike, so that the same program scores them.
        going_on = straight(forecast.observed, future.shape[1])
        samples[STRAIGHT] = np.repeat(going_on[None], len(next(iter(samples.values()))), axis=0)
        for name, each in samples.items():
            length = each.shape[2]
            running = self.scores.setdefault(name, RunningScore())
            there = np.all(known[:, :length], axis=1)
            if there.any():
                running.add(score(each, future[:, :length], there), int(there.sum()))
        unknown = len(ids) - int(np.all(known, axis=1).sum())
        if unknown:
            self.dropped["future unknown"] += unknown
        return dataclasses.replace(forecast, future=future)


def _horizon(forecast: Forecast) -> int:
    return max(result.mean.shape[1] for result in forecast.models.values())


def straight(observed: np.ndarray, steps: int) -> np.ndarray:
    """[N, steps, 2] of people `observed` [N, T, 2] who go on as between their last two steps."""
    step = np.diff(observed[:, -2:], axis=1).sum(axis=1, keepdims=True)
    return observed[:, -1:] + np.arange(1, steps + 1)[:, None] * step


def _so_far(latencies: Collection[float], scores: Mapping[str, RunningScore]) -> dict[str, Any]:
    values = [None] * len(PERCENTILES)
    if latencies:
        values = np.percentile(1e3 * np.array(latencies), PERCENTILES).tolist()
    return {
        "latency_ms": {f"p{p}": value for p, value in zip(PERCENTILES, values)},
        "models": {name: score.means() for name, score in scores.items()},
    }
