"""The predictor of a robot: frames of people in, forecasts out.

Every frame has a forecast, that of `neurosym_jax.predict` for the same window,
recording name and index of its first step, whether frames come live or from a file.
"""

import dataclasses
import functools
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from neurosym_jax.configuration import Count, refuse
from neurosym_jax.data.windows import bucket_of
from neurosym_jax.errors import InputError
from neurosym_jax.forecasting.distribution import draw_futures
from neurosym_jax.forecasting.model import Model, SceneForecaster
from neurosym_jax.forecasting.model_folder import load_model
from neurosym_jax.forecasting.tracking_errors import was_repaired
from neurosym_jax.scene import Scene, make_scene, pad_scene
from neurosym_robot.online.programs import Programs, When
from neurosym_robot.online.window import Window, nearest_first

# seconds waited for the end of a future, for people lost for a moment there
GRACE = 1.0


@dataclasses.dataclass(frozen=True, eq=False)
class ModelForecast:
    """One model's forecast of N people, float64 metres in the world's frame."""

    samples: (
        np.ndarray
    )  # [k, N, pred_len, 2]: sample s is one future of everybody together
    mean: np.ndarray  # [N, pred_len, 2]: over the samples
    central: int
    """The most probable sample; where all have the same probability the medoid, whose squared
    distances to all others have the least sum."""
    # [k] of the samples; None where all have the same
    probability: np.ndarray | None = None
    runtime: float = 0.0
    """Seconds to the samples; models that run side by side share the cores."""
    draw: Callable[[], np.ndarray] | None = None
    """Returns `draws`; None for a model whose samples are equally probable."""

    @property
    def weights(self) -> np.ndarray:
        """[k] probabilities of the samples, which sum to one."""
        count = len(self.samples)
        return (
            np.full(count, 1 / count) if self.probability is None else self.probability
        )

    @functools.cached_property
    def draws(self) -> np.ndarray:
        """[k, N, pred_len, 2] equally probable futures: for probabilities, regions and risks.

        They are drawn when they are asked for; `samples` are chosen to cover what may
        happen.
        """
        return self.samples if self.draw is None else self.draw()

    @property
    def weighted(self) -> tuple[np.ndarray, np.ndarray, int]:
        """Futures [K, N, pred_len, 2], their probabilities [K], and which of them is central.

        They are the draws, and the central sample with probability 0.
        """
        if self.draw is None:
            return self.samples, self.weights, self.central
        count = len(self.draws)
        futures = np.concatenate(
            [self.draws, self.samples[self.central : self.central + 1]]
        )
        return futures, np.append(np.full(count, 1 / count), 0), count


@dataclasses.dataclass(frozen=True, eq=False)
class Forecast:
    """One moment's forecast of N people; metres are float64 in the world's frame."""

    stamp: float  # seconds, of the newest frame; the future's steps follow period by period
    index: int  # number of that step since time 0, on which the noise depends
    ids: np.ndarray  # [N] int64, ascending
    observed: np.ndarray  # [N, obs_len, 2] metres, resampled
    models: Mapping[str, ModelForecast]  # by name of the model
    dropped: Mapping[
        int, str
    ]  # why others who are followed have none, as `Predictor.dropped`
    latency: float  # seconds of this computer's clock, from the frame's arrival to this forecast
    extrapolated: np.ndarray
    """[N] int64: number of final steps in `observed` that were extrapolated at constant velocity,
    not seen."""
    future: np.ndarray | None = None
    """[N, pred_len, 2] metres, what happened, NaN if not seen; `Analytics` adds it."""


class Predictor:
    """Forecasts a stream of frames with one model, or with several that share the window."""

    def __init__(
        self,
        models: Model | Mapping[str, Model],
        period: float | None = None,
        max_people: int = 64,
        samples: int = 20,
        seed: int = 0,
        *,
        recording: str = "",
        repair: bool = True,
        compile: When = "start",
        report: Callable[[str], None] = lambda text: None,
        **window: Any,
    ):
        """Compile the programs, or start to, as `compile` says; `window` are options of `Window`.

        `models` are one, called by its own name, or several by name; their `samples`
        are k futures each, and the `period` in seconds is by default that of their
        training data. The nearest `max_people` are forecast. Noise depends on `seed`,
        `recording` and the index of the first observed step, as in `predict`. With
        `repair`, SGAN and NeuroSyM see plausible tracks in place of tracking errors;
        anchors always do. `report` is called with one line before each program is compiled, after which the
        process's objects are frozen (`gc.freeze`). InputError for numbers out of range,
        no model, or models that observe different spans.
        """
        self.models = (
            {models.name: models} if isinstance(models, Model) else dict(models)
        )
        configs = [model.config for model in self.models.values()]
        lengths = {config.obs_len for config in configs}
        periods = {config.period for config in configs} if period is None else {period}
        if len(lengths) != 1:
            raise InputError(
                f"models must observe the same number of steps, not {sorted(lengths)}"
            )
        if len(periods) != 1:
            raise InputError(
                f"models must have steps of one length, not {sorted(periods)} s"
            )
        refuse(Count, {"max_people": max_people})
        step = float(periods.pop())
        self.seconds_ahead = step * max(config.pred_len for config in configs)
        """Seconds from the newest frame to the end of the longest forecast."""
        self.window = Window(
            lengths.pop(), step, memory=self.seconds_ahead + GRACE, **window
        )
        self.health = self.window.health
        """Counts of what was wrong with the stream so far, by the names in `window.HEALTH`."""
        self.max_people, self.recording = max_people, recording
        self.dropped: dict[int, str] = {}
        """Why people who are followed have no forecast of the newest frame: "short" of
        observations, "unseen" in that frame, "crowded" out by the nearest `max_people`, or
        "compiling": no program for so many people is ready yet."""
        self.waited = 0.0
        """Seconds so far that forecasts waited for programs that they needed."""
        self._forecasters = {
            name: SceneForecaster(
                model.forecaster,
                model.params,
                samples=samples,
                seed=seed,
                repair=repair,
            )
            for name, model in self.models.items()
        }
        sizes = {int(bucket_of(people + 1)) for people in range(max_people)}
        self._repairs = repair or any(
            model.forecaster.repairs for model in self.models.values()
        )
        self.programs = Programs(sorted(sizes), compile, report, self._example)
        """What is compiled for these forecasts, and for what is computed of them."""

    def push(
        self,
        stamp: float,
        ids: ArrayLike,
        xy: ArrayLike,
        focus: ArrayLike | None = None,
    ) -> Forecast | None:
        """Take in one frame; return its forecast if anybody's window is whole.

        `window.push` and `forecast` in one: of several that wait, only the last needs
        the second. A frame is everybody seen at the `stamp` [s] of the message's
        header: `ids` [N] whole numbers at `xy` [N, 2] world metres. Beyond
        `max_people`, those nearest to `focus` [2] are forecast, the robot, by default
        those nearest to the centre of all.

        Raises:
            InputError: if the shapes differ; whatever else is wrong is counted in
                `health`.
        """
        return self.forecast(focus) if self.window.push(stamp, ids, xy, focus) else None

    def forecast(self, focus: ArrayLike | None = None) -> Forecast | None:
        """The forecast of the newest frame; None, and everybody is `dropped`, without a window."""
        began, waited = time.perf_counter(), self.waited
        people, observed, extrapolated = self.window.complete()
        self.dropped = self.window.incomplete(people)
        before = time.perf_counter()
        slots = self.programs.fit(len(people)) if len(people) else 0
        self.waited += time.perf_counter() - before
        most = min(slots, self.max_people)
        if len(people) > most:
            order = nearest_first(observed[:, -1], focus)
            self.dropped |= dict.fromkeys(people[order[most:]].tolist(), "compiling")
            self.dropped |= dict.fromkeys(
                people[order[self.max_people :]].tolist(), "crowded"
            )
            near = np.sort(order[:most])
            people, observed, extrapolated = (
                people[near],
                observed[near],
                extrapolated[near],
            )
        if not len(people):
            return None
        index, stamp = self.window.index, self.window.stamp
        if self._repairs:
            changed = was_repaired(observed, self.window.period)
            self.health["repaired"] += int(changed.sum())
        models = self._forecast(observed, index - self.window.steps + 1, slots)
        took = time.perf_counter() - began - (self.waited - waited)
        return Forecast(
            stamp, index, people, observed, models, self.dropped, took, extrapolated
        )

    def _example(self, size: int) -> Forecast:
        """The forecast of `size` people, for whom programs are compiled."""
        observed, seen = np.zeros((size, self.window.steps, 2)), np.zeros(size, int)
        models = self._forecast(observed, 0, size)
        return Forecast(0.0, 0, np.arange(size), observed, models, {}, 0.0, seen)

    def _forecast(
        self, observed: np.ndarray, frame: int, slots: int
    ) -> dict[str, ModelForecast]:
        """Forecasts by model; the window of N people, in `slots`, begins at step `frame`."""
        scene = make_scene(observed, recording=self.recording, frame=frame)
        padded = pad_scene(scene, slots)
        start, models = time.perf_counter(), {}
        # All are begun before the first is waited for.
        started = {
            name: model.start(padded) for name, model in self._forecasters.items()
        }
        for name, futures in started.items():
            result = _summary(*SceneForecaster.finish(futures, scene))
            draw = None
            if result.probability is not None:
                draw = functools.partial(
                    _draw, self._forecasters[name], padded, len(observed)
                )
            took = time.perf_counter() - start
            models[name] = dataclasses.replace(result, runtime=took, draw=draw)
        return models


def _draw(model: SceneForecaster, padded: Scene, people: int) -> np.ndarray:
    """[k, N, pred_len, 2] draws for N `people`, by the program of the `padded` scene's size."""
    return draw_futures(model, padded, model.samples)[:, :people]


def _summary(samples: np.ndarray, probability: np.ndarray | None) -> ModelForecast:
    if probability is not None:
        mean, nearness = np.tensordot(probability, samples, axes=1), probability
    else:
        # The sum of squared distances to all others is least for the sample nearest to
        # the mean.
        mean = samples.mean(axis=0)
        nearness = -((samples - mean) ** 2).sum(axis=(1, 2, 3))
    return ModelForecast(samples, mean, int(nearness.argmax()), probability)


def load_models(paths: Sequence[Path]) -> dict[str, Model]:
    """Models by their files' names, such as `recommended`, with the folder's if needed.

    Raises:
        InputError: for no path, what is no model, or the same name twice.
    """
    if not paths:
        raise InputError("--model needs at least one model")
    full = [path.resolve() for path in paths]
    names = [path.stem for path in full]
    if len(set(names)) < len(names):
        names = [f"{path.parent.name}/{path.stem}" for path in full]
    if len(set(names)) < len(names):
        raise InputError(f"models must differ in name: {', '.join(map(str, paths))}")
    return {name: load_model(path) for name, path in zip(names, paths)}
