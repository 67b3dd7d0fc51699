"""A stream of frames through stitching, prediction and scores, in real time or faster.

Scores are running errors of forecasts as the future arrives, the same live and in a
replay: one forecast a period is scored, against what the predictor's window has seen
since. Only people whose whole future was observed are scored; the others are counted
with the reason.
"""

import collections
import dataclasses
import math
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np

from neurosym_jax.data.tracks import SNAP
from neurosym_jax.errors import InputError
from neurosym_robot.online.predictor import GRACE, Forecast, Predictor
from neurosym_robot.online.regions import Recalibration
from neurosym_robot.tracking.following import Frame
from neurosym_robot.tracking.stitching import OnlineStitcher

STRAIGHT = "constant velocity"  # scored beside the models, as a baseline
PUBLISHED = ("published_ade", "published_fde")  # names in `Analytics.summary`
LONGEST = 10.0  # seconds waited at most between two frames


class Analytics:
    """Running scores of the models of a predictor's forecasts, and of `STRAIGHT`."""

    def __init__(self, predictor: Predictor):
        """Compile the scores with the programs of `predictor`."""
        self.forecasts = 0
        self.dropped: collections.Counter[str] = collections.Counter()
        """People without a forecast by reason, once for each forecast that they are missing in;
        and people with a forecast that cannot be scored: "future unknown"."""
        # By model: forecasts and people scored, and [2, ...] total and count of the
        # metrics so far.
        self._scored = collections.Counter[str]()
        self._people = collections.Counter[str]()
        self._sums: dict[str, dict[str, Any]] = {}
        # milliseconds and forecasts so far
        self._runtime: dict[str, tuple[float, int]] = {}
        self._window = predictor.window
        self._scales = predictor.scales
        self._score_of, self._metrics = _metrics_of(predictor)
        self._wait = predictor.seconds_ahead + GRACE
        self._pending: collections.deque[Forecast] = collections.deque()
        self.regions: dict[str, Recalibration] = {}
        """By model that makes more than one forecast."""
        predictor.programs.add(self._rehearse)

    def add(self, forecast: Forecast | None) -> list[Forecast]:
        """Take in what the newest frame brought; return the forecasts that it completed.

        One forecast a period is followed, and returned with its `future`.
        """
        done = []
        if self._pending and self._window.stamp < self._pending[-1].stamp:
            done = self.finish()  # The clock was set back: their future never comes.
        for name, regions in self.regions.items():
            regions.learn()
            self._scales[name] = regions.scale
        complete = self._window.stamp - self._wait
        while self._pending and self._pending[0].stamp <= complete:
            done.append(self._score(self._pending.popleft()))
        if forecast is None:
            return done
        self.dropped.update(forecast.dropped.values())
        if len(forecast.ids):
            self._follow(forecast)
        return done

    def _follow(self, forecast: Forecast) -> None:
        """Count a forecast; wait for its future if the last such one is a period old."""
        self.forecasts += 1
        for name, result in forecast.models.items():
            total, count = self._runtime.get(name, (0.0, 0))
            self._runtime[name] = total + 1e3 * result.runtime, count + 1
        newest = self._pending[-1].stamp if self._pending else -np.inf
        if forecast.stamp - newest < self._window.period - SNAP:
            return
        self._pending.append(forecast)
        for name, result in forecast.models.items():
            if len(result.draws) < 2:
                continue
            if name not in self.regions:
                self.regions[name] = Recalibration(self._window)
            self.regions[name].add(forecast.stamp, forecast.ids, result.draws)

    def finish(self) -> list[Forecast]:
        """At the end of a recording, score the forecasts that wait, and return them."""
        done = [self._score(forecast) for forecast in self._pending]
        self._pending.clear()
        for regions in self.regions.values():
            regions.clear()
        return done

    def summary(self) -> dict[str, Any]:
        """JSON-able counts, and means in metres or None before the first.

        Of each model `published_ade` and `published_fde` are errors of the central
        forecast, which is published; other metrics take the best of its samples by
        hindsight. `runtime` is the mean of milliseconds that a forecast takes,
        `coverage` the share of the true positions of the last five minutes that
        recalibrated regions held, by their level in per cent.
        """

        return {
            "forecasts": self.forecasts,
            "pending": len(self._pending),
            "dropped": dict(+self.dropped),
            "models": {name: self._means(name) for name in self._sums},
        }

    def _means(self, name: str) -> dict[str, Any]:
        """The row of a model in `summary`."""
        nothing = np.zeros(2)
        runtime = np.array(self._runtime.get(name, nothing))
        means = {
            "forecasts": self._scored[name],
            "people": self._people[name],
            "runtime": _mean(*runtime),
            "coverage": self._coverage(name),
        }
        for key in (*PUBLISHED, *self._metrics):
            means[key] = _mean(*self._sums[name].get(key, nothing))
        return means

    def _coverage(self, name: str) -> dict[str, float]:
        shares = self.regions[name].coverage() if name in self.regions else {}
        return {f"{100 * level:.0f}": share for level, share in shares.items()}

    def _rehearse(self, forecast: Forecast) -> None:
        """Compute what is done with a forecast, so that its programs are compiled."""
        for result in forecast.models.values():
            result.draws  # noqa: B018
        for futures in _with_straight(forecast).values():
            self._score_of(futures, futures[0])

    def _score(self, forecast: Forecast) -> Forecast:
        """Compare a forecast with what happened: here truth meets what was forecast."""
        samples = _with_straight(forecast)
        steps = np.arange(1, samples[STRAIGHT].shape[2] + 1)
        times = forecast.stamp + self._window.period * steps
        future = self._window.resampled(forecast.ids, times)
        for name, futures in samples.items():
            central = 0
            if name in forecast.models:
                central = forecast.models[name].central
            self._score_model(name, futures, central, future[:, : futures.shape[2]])
        is_known = np.isfinite(future).all(axis=(1, 2))
        self.dropped["future unknown"] += int(np.sum(~is_known))
        return dataclasses.replace(forecast, future=future)

    def _score_model(
        self, name: str, futures: np.ndarray, central: int, future: np.ndarray
    ) -> None:
        """Add the errors of `futures [k, N, T, 2]`, of people whose `future [N, T, 2]` is known."""
        is_whole: Any = np.isfinite(future).all(axis=(1, 2))
        if not is_whole.any():
            return
        count = int(is_whole.sum())
        self._scored[name] += 1
        self._people[name] += count
        sums = self._sums.setdefault(name, {})

        offset = futures[central, is_whole] - future[is_whole]
        off = np.linalg.norm(offset, axis=-1)
        totals = off.mean(axis=1).sum(), off[:, -1].sum()
        for metric, total in zip(PUBLISHED, totals):
            sums[metric] = sums.get(metric, 0) + np.array([total, count])
        for metric, score in self._score_of(futures, future, is_whole).items():
            total_and_count = np.broadcast_arrays(score.total[0], score.count[0])
            sums[metric] = sums.get(metric, 0) + np.stack(total_and_count)


def _metrics_of(predictor: Predictor) -> tuple[Callable[..., Any], list[str]]:
    """The metrics of futures, and their names; none of a predictor without JAX."""
    if predictor.is_light:
        return lambda *arrays: {}, []
    from neurosym_jax.evaluation.metrics import metric_names
    from neurosym_jax.evaluation.scores import score

    return score, list(metric_names())


def _with_straight(forecast: Forecast) -> dict[str, np.ndarray]:
    """Samples by model, and of `STRAIGHT` as many as a model's, for the same program."""
    samples = {name: result.samples for name, result in forecast.models.items()}
    first = next(iter(samples.values()))
    steps = max(futures.shape[2] for futures in samples.values())
    going_on = straight(forecast.observed, steps)
    return samples | {STRAIGHT: np.repeat(going_on[None], len(first), axis=0)}


def straight(observed: np.ndarray, steps: int) -> np.ndarray:
    """[N, steps, 2] of people `observed` [N, T, 2] who go on as between their last two steps."""
    step = np.diff(observed[:, -2:], axis=1).sum(axis=1, keepdims=True)
    number = np.arange(1, steps + 1)[:, None]
    return observed[:, -1:] + number * step


class ReplayEvent(NamedTuple):
    """What follows from a frame."""

    frame: Frame  # as the predictor saw it, with mended ids if there is a stitcher
    # of nobody where nobody is; None if the frame was refused
    forecast: Forecast | None
    scored: Sequence[Forecast] = ()  # those whose future is known now
    skipped: int = 0  # older frames that were observed, but not forecast
    age: float = math.nan  # seconds from stamp to forecast, by the recording's clock
    robot: np.ndarray | None = None  # [3] its pose in metres, metres, radians, if known
    # whether the window took the frame in; else its stamp was refused
    accepted: bool = True


def advance(
    frames: Sequence[Frame], predictor: Predictor, robot: np.ndarray | None = None
) -> ReplayEvent:
    """Observe all frames, and forecast the newest; those nearest to the `robot` [3] go first."""
    focus = None if robot is None else robot[:2]
    accepted = [frame for frame in frames if predictor.window.push(*frame, focus=focus)]
    if not accepted:
        return ReplayEvent(frames[-1], None, robot=robot, accepted=False)
    forecast = predictor.forecast(focus)
    return ReplayEvent(accepted[-1], forecast, skipped=len(accepted) - 1, robot=robot)


def replay(
    frames: Iterable[Frame],
    predictor: Predictor,
    analytics: Analytics,
    *,
    rate: float = math.inf,
    stitcher: OnlineStitcher | None = None,
    robot: Callable[[float], np.ndarray | None] = lambda stamp: None,
) -> Iterator[ReplayEvent]:
    """Push frames one by one; an event for each.

    At the end, `analytics.finish()` scores the forecasts that still wait. `rate` 1 is
    the speed of the stamps, infinite does not wait; `robot` returns the robot's pose
    [3] at a stamp, if known.

    Raises:
        InputError: for a rate that is not positive.
    """
    if not rate > 0:
        raise InputError(f"rate must be positive, not {rate}")
    deadline, last = time.monotonic(), math.inf
    for frame in frames:
        if math.isinf(last):  # Opening the recording takes time, too.
            deadline = time.monotonic()
        if math.isfinite(rate) and math.isfinite(frame.stamp):
            deadline += min(max(frame.stamp - last, 0.0), LONGEST) / rate
            time.sleep(max(0.0, deadline - time.monotonic()))
            last = frame.stamp
        mended = frame if stitcher is None else stitcher.mend(frame)
        waited = predictor.waited
        event = advance([mended], predictor, robot(frame.stamp))
        deadline += predictor.waited - waited  # The recording waits for the compiler.
        age = time.monotonic() - deadline
        predictor.learn()
        yield event._replace(age=age, scored=analytics.add(event.forecast))


def _mean(total: Any, count: Any) -> Any:
    """`total / count` as a number or list, None where nothing was counted."""
    if not count.any():
        return None
    return (total / count).tolist()
