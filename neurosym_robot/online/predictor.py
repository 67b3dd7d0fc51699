"""The predictor of a robot: frames of people in, forecasts out.

Every frame has a forecast, that of `neurosym_jax.predict` for the same window,
recording name and index of its first step, whether frames come live or from a file.
"""

import dataclasses
import functools
import math
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from neurosym_jax.configuration import Count, refuse
from neurosym_jax.errors import InputError
from neurosym_jax.models.tracking_errors import was_repaired
from neurosym_robot.online.onnx_network import OnnxModel, OnnxNetwork
from neurosym_robot.online.programs import Programs, When
from neurosym_robot.online.regions import Regions
from neurosym_robot.online.window import Observed, Window, nearest_first

if TYPE_CHECKING:
    from neurosym_jax.models.forecast import Model
    from neurosym_jax.models.place.mixture import Remembered
    from neurosym_jax.models.place.place import Place
    from neurosym_jax.scene import Scene

# seconds waited for the end of a future, for people lost for a moment there
GRACE = 1.0

Recall = Callable[[np.ndarray, "Scene", int], "Remembered"]


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
    scale: np.ndarray | float = 0.0
    """[L, T] of the regions, as `Recalibration` learned it."""

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

    @functools.cached_property
    def regions(self) -> Regions:
        """Where each person will be with the probabilities `LEVELS`, recalibrated."""
        return Regions.around(self.draws, self.scale)

    @property
    def weighted(self) -> tuple[np.ndarray, np.ndarray, int]:
        """Futures [K, N, pred_len, 2], their probabilities [K], and which of them is central.

        They are the draws, and the central sample with probability 0 if it is none of
        them.
        """
        count = len(self.draws)
        if self.probability is None:
            return self.draws, np.full(count, 1 / count), self.central
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
    seen: np.ndarray
    """[N] seconds of the observed window since the first sighting; what is before is a line."""
    whereabouts: np.ndarray
    """[M, 2] metres, where those `dropped` are in this frame, NaN if unseen."""
    future: np.ndarray | None = None
    """[N, pred_len, 2] metres, what happened, NaN if not seen; `Analytics` adds it."""


class Predictor:
    """Forecasts a stream of frames with one model, or with several that share the window."""

    def __init__(
        self,
        models: "Model | OnnxModel | Mapping[str, Model | OnnxModel]",
        period: float | None = None,
        max_people: int = 64,
        samples: int = 20,
        seed: int = 0,
        *,
        recording: str = "",
        repair: bool = True,
        place: "Place | None" = None,
        compile: When = "start",
        report: Callable[[str], None] = lambda text: None,
        **window: Any,
    ):
        """Compile the programs, or start to, as `compile` says; `window` are options of `Window`.

        `models` are one, called by its own name, or several by name; their `samples`
        are k futures each, and the `period` in seconds is by default that of their
        training data. The nearest `max_people` are forecast. Noise depends on `seed`,
        `recording` and the index of the first observed step, as in `predict`; that of
        draws on no step. With `repair`, SGAN and NeuroSyM see plausible tracks in place
        of tracking errors; anchors always do. A `place` of one of the models watches
        whoever is forecast, and that model's draws take from it. `report` is called
        with a line before each program is compiled; then the process's objects are
        frozen (`gc.freeze`). InputError for numbers out of range, no model, models that
        observe different spans, or a place of another model or period.
        """
        self.models = _by_name(models)
        steps, step = _common_steps(self.models, period)
        self.place = _checked_place(place, self.models, step)
        refuse(Count, {"max_people": max_people})
        ahead = max(model.config.pred_len for model in self.models.values())
        self.seconds_ahead = step * ahead
        """Seconds from the newest frame to the end of the longest forecast."""
        self.window = Window(steps, step, memory=self.seconds_ahead + GRACE, **window)
        self.health = self.window.health
        """Counts of what was wrong with the stream so far, by the names in `window.HEALTH`."""
        self.max_people, self.recording = max_people, recording
        self.dropped: dict[int, str] = {}
        """Why people who are followed have no forecast of the newest frame: "short" of
        observations, "unseen" in that frame, "crowded" out by the nearest `max_people`, or
        "compiling": no program for so many people is ready yet."""
        self.scales: dict[str, np.ndarray] = {}
        """By model the scale of its regions, which `Analytics` learns."""
        self.waited = 0.0
        """Seconds so far that forecasts waited for programs that they needed."""
        options = samples, seed, repair, max_people
        networks = [_network_of(model, *options) for model in self.models.values()]
        self._networks = dict(zip(self.models, networks))
        self.is_light = all(isinstance(network, OnnxNetwork) for network in networks)
        """Whether it forecasts without JAX, and so scores no more than what is published."""
        self._repairs = any(network.repairs for network in networks)
        self._watched = -math.inf
        self._unlearned: tuple[float, Observed] | None = None
        self._rehearsed: dict[int, Remembered] = {}
        sizes = set().union(*(network.sizes(max_people) for network in networks))
        self.programs = Programs(sorted(sizes), compile, report, self._example)
        """What is compiled for these forecasts, and for what is computed of them."""

    def push(
        self,
        stamp: float,
        ids: ArrayLike,
        xy: ArrayLike,
        focus: ArrayLike | None = None,
    ) -> Forecast | None:
        """Take in one frame; return its forecast, or None if the frame is refused.

        `window.push`, `forecast` and `learn` in one: of several that wait, only the
        last needs a forecast. A frame is everybody seen at the `stamp` [s] of the message's
        header: `ids` [N] whole numbers at `xy` [N, 2] world metres. Beyond
        `max_people`, those nearest to `focus` [2] are forecast, the robot, by default
        those nearest to the centre of all.

        Raises:
            InputError: if the shapes differ; whatever else is wrong is counted in
                `health`.
        """
        if not self.window.push(stamp, ids, xy, focus):
            return None
        forecast = self.forecast(focus)
        self.learn()
        return forecast

    def forecast(self, focus: ArrayLike | None = None) -> Forecast:
        """The forecast of the newest frame, which may be of nobody."""
        self.learn()
        began, waited = time.perf_counter(), self.waited
        observed = self.window.complete()
        self.dropped = self.window.incomplete(observed.ids)
        slots = 0
        if len(observed.ids):
            slots = self.programs.fit(len(observed.ids))
            self.waited += time.perf_counter() - began
        observed = self._nearest(observed, min(slots, self.max_people), focus)
        if self._repairs and len(observed.ids):
            changed = was_repaired(observed.positions, self.window.period)
            self.health["repaired"] += int(changed.sum())
        recall = None if self.place is None else self.place.recalled
        models = self._forecast(observed, self.window.index, slots, recall)
        self._unlearned = self.window.stamp, observed
        places = self.window.resampled([*self.dropped], [self.window.stamp])
        took = time.perf_counter() - began - (self.waited - waited)
        return Forecast(
            stamp=self.window.stamp,
            index=self.window.index,
            ids=observed.ids,
            observed=observed.positions,
            models=models,
            dropped=self.dropped,
            latency=took,
            extrapolated=observed.extrapolated,
            seen=observed.seen,
            whereabouts=places[:, 0],
        )

    def learn(self) -> None:
        """Let the place learn from those who were seen in the newest forecast.

        Called once the forecast is published, so that nobody waits for it; the next
        forecast calls it, too.
        """
        unlearned, self._unlearned = self._unlearned, None
        if self.place is None or unlearned is None:
            return
        stamp, observed = unlearned
        if stamp <= self._watched:  # The clock was set back.
            self.place.begin()
        self._watched = stamp
        seen = observed.take(np.flatnonzero(observed.extrapolated == 0))
        self.place.watch(seen.positions[:, -1], seen.ids, stamp)

    def _rehearse(self, size: int) -> "Remembered":
        """What the place recalls of `size` people; the first time that is compiled."""
        assert self.place is not None
        if size not in self._rehearsed:
            self._rehearsed[size] = self.place.rehearse(size)
        return self._rehearsed[size]

    def _nearest(
        self, observed: Observed, most: int, focus: ArrayLike | None
    ) -> Observed:
        """The people who are forecast; the others are `dropped`."""
        if len(observed.ids) <= most:
            return observed
        order = nearest_first(observed.positions[:, -1], focus)
        compiling = observed.ids[order[most : self.max_people]].tolist()
        crowded = observed.ids[order[self.max_people :]].tolist()
        self.dropped |= dict.fromkeys(compiling, "compiling")
        self.dropped |= dict.fromkeys(crowded, "crowded")
        return observed.take(np.sort(order[:most]))

    def _example(self, size: int) -> Forecast:
        """The forecast of `size` people, for whom programs are compiled."""
        zeros = np.zeros(size)
        positions = np.zeros((size, self.window.steps, 2))
        sighted = np.ones(positions.shape[:2], bool)
        observed = Observed(
            np.arange(size), positions, zeros.astype(int), zeros, zeros, sighted
        )
        recall = None
        if self.place is not None:
            # The place itself may be watching in another thread.
            recall = lambda *arguments: self._rehearse(size)  # noqa: E731
        return Forecast(
            stamp=0.0,
            index=0,
            ids=observed.ids,
            observed=positions,
            models=self._forecast(observed, 0, size, recall),
            dropped={},
            latency=0.0,
            extrapolated=observed.extrapolated,
            seen=observed.seen,
            whereabouts=np.zeros((0, 2)),
        )

    def _forecast(
        self, observed: Observed, index: int, slots: int, recall: Recall | None
    ) -> dict[str, ModelForecast]:
        """Forecasts by model of N people, in `slots`, whose window ends at step `index`.

        `recall` is `Place.recalled`, if there is a place.
        """
        people = len(observed.ids)
        if not people:
            return {name: self._of_nobody(name) for name in self.models}
        frame = index - self.window.steps + 1
        start = time.perf_counter()
        # All are begun before the first is waited for.
        pending = {}
        for name, network in self._networks.items():
            pending[name] = network.start(observed, self.recording, frame, slots)
        # At once, for later the place has seen more; and beside the networks.
        memories: dict[str, Remembered] = {}
        if recall is not None:
            for name in filter(self._learns, pending):
                scene = pending[name].scene
                memories[name] = recall(observed.positions, scene, slots)
        models = {}
        for name, network in self._networks.items():
            result = _summary(*network.finish(pending[name]))
            memory = memories.get(name)
            central = result.central if result.probability is None else None
            arguments = pending[name], result.samples, central, self.recording, memory
            draw = network.drawing(*arguments)
            if observed.doubt.any():
                draw = functools.partial(
                    _widened, result, draw, observed, self.window.period
                )
            took = time.perf_counter() - start
            models[name] = dataclasses.replace(
                result, runtime=took, draw=draw, scale=self.scales.get(name, 0.0)
            )
        return models

    def _learns(self, name: str) -> bool:
        """Whether the model of this name is the one that the place is watched with."""
        return self.place is not None and self.models[name] is self.place.model

    def _of_nobody(self, name: str) -> ModelForecast:
        samples = self._networks[name].samples
        length = self.models[name].config.pred_len
        return ModelForecast(
            np.zeros((samples, 0, length, 2)), np.zeros((0, length, 2)), 0
        )


def _by_name(
    models: "Model | OnnxModel | Mapping[str, Model | OnnxModel]",
) -> "dict[str, Model | OnnxModel]":
    """The models by name; a single one has its own."""
    if isinstance(models, Mapping):
        return dict(models)
    return {models.name: models}


def _common_steps(models: Mapping[str, Any], period: float | None) -> tuple[int, float]:
    """Steps that all models observe, and seconds between them, by default the models'."""
    configs = [model.config for model in models.values()]
    lengths = {config.obs_len for config in configs}
    if len(lengths) != 1:
        raise InputError(
            f"models must observe the same number of steps, not {sorted(lengths)}"
        )
    periods = {config.period for config in configs}
    if period is not None:
        periods = {period}
    if len(periods) != 1:
        raise InputError(
            f"models must have steps of one length, not {sorted(periods)} s"
        )
    return lengths.pop(), float(periods.pop())


def _checked_place(
    place: "Place | None", models: Mapping[str, Any], period: float
) -> "Place | None":
    """The place, if it is one of a model's."""
    if place is None:
        return None
    if all(model is not place.model for model in models.values()):
        raise InputError("place: it is watched with another model")
    if place.model.config.period != period:
        raise InputError(
            f"place: it is watched in steps of {place.model.config.period:g} s, "
            f"not of a period of {period:g} s"
        )
    return place


def _network_of(
    model: "Model | OnnxModel", samples: int, seed: int, repair: bool, most: int
) -> Any:
    """What calls a model, for up to `most` people."""
    if isinstance(model, OnnxModel):
        return OnnxNetwork(model, samples, seed, most)
    # Only here, so that a predictor of an .onnx file needs no JAX.
    from neurosym_robot.online.networks import Network

    return Network(model, samples, seed, repair)


def _widened(
    result: ModelForecast,
    draw: Callable[[], np.ndarray] | None,
    observed: Observed,
    period: float,
) -> np.ndarray:
    """Draws [k, N, pred_len, 2], as uncertain as the velocities of who was hardly seen.

    A person's deviations stay the same from frame to frame, and the central sample of
    equally probable ones stays as it is.
    """
    futures = result.samples.copy() if draw is None else draw().copy()
    seconds = period * np.arange(1, futures.shape[2] + 1)[:, None]
    for row in np.flatnonzero(observed.doubt):
        rng = np.random.default_rng(abs(int(observed.ids[row])))
        velocity = observed.doubt[row] * rng.normal(size=(len(futures), 1, 2))
        if draw is None:
            velocity[result.central] = 0.0
        futures[:, row] += velocity * seconds
    return futures


def _summary(samples: np.ndarray, probability: np.ndarray | None) -> ModelForecast:
    if probability is not None:
        mean, nearness = np.tensordot(probability, samples, axes=1), probability
    else:
        # The sum of squared distances to all others is least for the sample nearest to
        # the mean.
        mean = samples.mean(axis=0)
        nearness = -((samples - mean) ** 2).sum(axis=(1, 2, 3))
    return ModelForecast(samples, mean, int(nearness.argmax()), probability)


def load_models(paths: Sequence[Path]) -> "dict[str, Model | OnnxModel]":
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
    models = {}
    for name, path in zip(names, paths):
        if path.suffix == ".onnx":
            models[name] = OnnxModel(path)
        else:
            from neurosym_jax.models.disk import load_model

            models[name] = load_model(path)
    return models
