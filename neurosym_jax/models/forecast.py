"""A trained model, and its forecasts: of single scenes in the world's frame, and of batches
of scenes.
"""

import dataclasses
import functools
import hashlib
import itertools
import json
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from typing import Any, Protocol

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.core import Tracer
from jax.typing import ArrayLike

from neurosym_jax.configuration import Count, Seed, differences, refuse, to_json
from neurosym_jax.data.windows import Batch, Windows, bucket_of, make_batches
from neurosym_jax.errors import InputError, warn_caller
from neurosym_jax.models.forecaster import (
    FORECASTERS,
    Forecaster,
    Representatives,
    TwoStageForecaster,
    draw_noise,
    forecaster_of,
    key_numbers,
    key_of,
    options_of,
    refuse_many,
    refuse_other_shapes,
    scene_noise,
    shapes_of,
)
from neurosym_jax.models.histories import whole_history
from neurosym_jax.models.place.mixture import Remembered
from neurosym_jax.models.place.samples import DRAWS, exchange_scene
from neurosym_jax.models.tracking_errors import (
    repair_scene,
    repair_tracks,
    settle,
    was_repaired,
)
from neurosym_jax.runtime.process import COMPILED_UNFUSED
from neurosym_jax.runtime.programs import full_precision, program
from neurosym_jax.scene import (
    AnyArray,
    Scene,
    checked_positions,
    make_scene,
    moves_of,
    pad_scene,
    scene_identity,
    to_world,
)
from neurosym_jax.symbolic.weighting import Weighting, checked_mask

__all__ = [
    "Model",
    "SceneForecaster",
    "batch_noise",
    "checked_scene",
    "digest_of",
    "draw_batch",
    "draw_futures",
    "forecast",
    "forecast_batch",
    "forecast_scene",
    "forecast_windows",
    "predict",
    "predict_batches",
    "predict_distribution",
    "predict_representatives",
    "predict_scenes",
    "recalled_by",
    "refuse_no_model",
    "refuse_other_length",
    "unpacked",
    "warn_of_tracking_errors",
]


# A trained model, and its forecasts of single scenes, in the world's frame.


@dataclasses.dataclass(frozen=True, eq=False)
class Model:
    """A forecaster's configuration and parameters, and their origin."""

    config: Any
    """The forecaster's `Config`: `GeneratorConfig` for SGAN and NeuroSyM."""
    params: Any
    """Nested dictionaries of arrays."""
    dataset: str | None = None
    """The data set to test it on, where known: left out of its training, or `simulations`, which
    has other recordings for training."""
    family: str = "generator"
    """The forecaster's key, see `register_forecaster`."""
    plugins: tuple[str, ...] = ()
    """Plugins it was trained with, for messages: none is imported because of them."""
    seed: int | None = None
    """Of its training; None where it is not known."""
    neighbours: float | None = None
    """Share of people with somebody within 2 m whose forecast their neighbours change, on the
    validation windows; None where nobody measured it."""
    assumed: tuple[str, ...] = ()
    """What its torch checkpoint does not say and was taken to be so, in words."""
    seen: str = ""
    """Fingerprint of its training windows, see `data.windows`; empty where it is not known."""
    data: Mapping[str, str] = dataclasses.field(default_factory=dict)
    """Licence of each data set that it learned from, by name; empty where not known."""
    step: int | None = None
    """Steps of training after which its parameters were kept; None where it is not known."""
    recipe: str = ""
    """Digest of its recipe without the seed; empty where it is not known."""
    called: str = ""
    """Name by which `load_model` was asked for it, if that is `recommended`."""

    @property
    def name(self) -> str:
        """Name in tables: `recommended`, if it was called so, else the forecaster's title."""
        return self.called or self.forecaster.title

    @property
    def forecaster(self) -> Forecaster:
        """The forecaster of this model's parameters."""
        return FORECASTERS[self.family](self.config)

    @property
    def identity(self) -> dict[str, Any]:
        """What says whether two models are trainings of one: columns of a report's rows.

        Trainings of one model share `configuration` and `training_data`, digests of
        what was trained, how and on what, and differ in `training_seed`; `parameters`
        is the digest of the numbers themselves. None where something is not known.
        """
        trained = [self.family, to_json(self.config), self.recipe]
        text = json.dumps(trained, sort_keys=True)
        leaves = map(np.ascontiguousarray, jax.tree.leaves(self.params))
        return {
            "configuration": digest_of(text.encode())[:16],
            "training_data": digest_of(self.seen.encode())[:16] if self.seen else None,
            "training_seed": self.seed,
            "parameters": digest_of(*leaves)[:16],
        }

    @property
    def weighting(self) -> Weighting | None:
        """The weighting of pairs; None for a model without symbols."""
        weighting = getattr(self.config, "weighting", None)
        return weighting if isinstance(weighting, Weighting) else None

    def __repr__(self) -> str:
        """Five lines, without the parameters' numbers and the config's defaults."""
        count = sum(map(np.size, jax.tree.leaves(self.params)))
        return (
            f"Model {self.name}\n"
            f"  family: {self.family}\n"
            f"  to be tested on: {self.dataset or 'not known'}\n"
            f"  config: {type(self.config).__name__}({', '.join(differences(self.config))})\n"
            f"  params: {count:,} numbers"
        )


def refuse_no_model(model: Any) -> None:
    """Refuse what is no `Model`, such as its name.

    Raises:
        InputError: with its type.
    """
    if not isinstance(model, Model):
        kind = type(model).__name__
        raise InputError(
            f'model must be one, such as load_model("recommended"), not {kind}'
        )


def digest_of(*contents: Any) -> str:
    """SHA-256 of bytes, or of arrays of one block each, after each other."""
    sha = hashlib.sha256()
    for content in contents:
        sha.update(content)
    return sha.hexdigest()


class PlaceLike(Protocol):
    """What a forecast asks of a `Place`."""

    model: Model
    """Which watches it."""

    def recalled(self, observed: np.ndarray, scene: Scene, slots: int) -> Remembered:
        """See `Place.recalled`."""
        ...


class SceneForecaster:
    """k futures of each scene it is called with, by one compiled program a bucket of sizes."""

    def __init__(
        self,
        forecaster: Forecaster,
        params: Any,
        *,
        samples: int,
        seed: int,
        repair: bool = False,
    ):
        """Move `params` to the device; nothing is compiled yet. For `repair` see `forecast_scene`."""
        refuse(Count, {"samples": samples})
        refuse(Seed, {"seed": seed})
        self.forecaster = forecaster
        self.samples = forecaster.count(samples)
        refuse_many(forecaster, self.samples, 1)
        _refuse_params(forecaster, params)
        self.repair = repair
        self.params = jax.device_put(params)
        self.key = key_numbers(seed)

    def __call__(self, scene: Scene) -> np.ndarray:
        """Futures [k, N, pred_len, 2], float64 metres in the world's frame."""
        return self.finish(self.start(scene), scene)[0]

    def start(self, scene: Scene) -> Representatives:
        """Begin the forecast of `scene`, of N slots, without waiting for it."""
        slots = int(bucket_of(len(scene.valid)))
        refuse_many(self.forecaster, self.samples, slots)
        padded = self.forecaster.prepared(pad_scene(scene.bare(), slots))
        spec = self.forecaster.noise
        noise: Any = np.zeros((self.samples, 0), np.float32)
        if spec.dim:
            agents = slots if spec.per_agent else 1
            noise = _noise(spec, self.key, padded.identity, self.samples, agents)
        return forecast_scene(self.forecaster, self.params, padded, noise, self.repair)

    @staticmethod
    def finish(
        started: Representatives, scene: Scene
    ) -> tuple[np.ndarray, np.ndarray | None]:
        """Wait for the forecast that `start(scene)` began.

        Returns [k, N, pred_len, 2], as calling does, and probabilities [k] as
        `Representatives`.
        """
        futures, probability = started
        people = len(scene.valid)
        world = to_world(np.asarray(futures)[:, :people], scene)
        if probability is None:
            return world, None
        return world, np.asarray(probability, np.float64)


@program((0, 4), compiler_options=options_of)
def forecast_scene(
    forecaster: Forecaster,
    params: Any,
    scene: Scene,
    noise: Any,
    repair: bool = False,
) -> Representatives:
    """`forecaster.representatives`, compiled; equal forecasters share the program.

    With `repair` it is given plausible tracks, see `repair_tracks`, and forecasts begin
    at the reported positions all the same. One that `repairs` tracks itself sees them
    as they are.
    """
    agents = scene.valid.shape[0]
    if not repair or forecaster.repairs:
        samples, probability = forecaster.representatives(params, scene, noise)
        return forecaster.checked_futures(samples, (None, agents)), probability
    period = forecaster.config.period
    scene, repaired = repair_scene(scene, period)
    samples, probability = forecaster.representatives(params, scene, noise)
    samples = forecaster.checked_futures(samples, (None, agents))
    return settle(samples, repaired, period), probability


# Apart from the forecast, because threefry is slow to compile and this serves every
# bucket.
@program((0, 3, 4), compiler_options=COMPILED_UNFUSED)
def _noise(spec, key, identity, samples, agents):
    return scene_noise(spec, key_of(key), identity, samples, agents)


def predict(
    model: Model,
    observed: ArrayLike,
    *,
    samples: int = 20,
    seed: int = 0,
    recording: str = "",
    frame: int = 0,
    repair: bool = False,
    place: PlaceLike | None = None,
) -> np.ndarray:
    """Forecast one scene in the caller's own frame.

    Args:
        model: see `load_model`.
        observed: [N, obs_len, 2] metres. A model with `forecaster.shortest` below
            obs_len takes 1 step or more, of which it uses the last obs_len, and NaN
            where an agent was not seen.
        samples: number of futures k; a deterministic model makes one.
        seed: with `recording` and `frame`, determines the noise.
        recording: name of the recording.
        frame: index of the first observed step in the recording.
        repair: give plausible tracks in place of tracking errors (see `repair_tracks`)
            to a network that takes positions as they are, SGAN's or NeuroSyM's. Anchors
            always see plausible tracks.
        place: what people did here before, see `predict_distribution`: some samples are
            exchanged for draws with it (`models.place.samples`), which take their
            probabilities; the most probable one stays.

    Returns:
        [k, N, pred_len, 2] float64 metres.

    Raises:
        InputError: for a wrong shape, an unusable coordinate, a number out of range, or
            a trace of jax's (`jit`, `vmap`, `grad`).
    """
    futures, _ = predict_representatives(
        model,
        observed,
        samples=samples,
        seed=seed,
        recording=recording,
        frame=frame,
        repair=repair,
        place=place,
    )
    return futures


def predict_representatives(
    model: Model,
    observed: ArrayLike,
    *,
    samples: int = 20,
    seed: int = 0,
    recording: str = "",
    frame: int = 0,
    repair: bool = False,
    place: PlaceLike | None = None,
) -> tuple[np.ndarray, np.ndarray]:
    """The futures that `predict` returns, and their probabilities [k].

    `anchors` learns the probabilities; the samples of other models have 1 / k each.
    Asked for fewer samples than it has, `anchors` gives the most probable one and those
    that with it represent all of them best, and the probabilities given that the future
    is one of these.

    Arguments are those of `predict`: `observed` is [N, obs_len, 2] metres.

    Raises:
        InputError: as `predict`.
    """
    scene = checked_scene(model, observed, recording, frame, repair)
    forecaster = SceneForecaster(
        model.forecaster, model.params, samples=samples, seed=seed, repair=repair
    )
    futures, probability = forecaster.finish(forecaster.start(scene), scene)
    if probability is None:
        probability = np.full(len(futures), 1 / len(futures))
    if place is not None:
        memory = recalled_by(place, model, scene)
        draws = draw_futures(forecaster, scene, DRAWS, memory)
        futures = exchange_scene(futures, probability, draws, memory)
    return futures, probability


def predict_distribution(
    model: Model,
    observed: ArrayLike,
    *,
    draws: int = 200,
    seed: int = 0,
    recording: str = "",
    frame: int = 0,
    repair: bool = False,
    place: PlaceLike | None = None,
) -> np.ndarray:
    """Equally probable futures of one scene, for probabilities, regions and risks.

    Those of `anchors` are drawn from what it learned by a proper score. For other
    models they are the samples of `predict`, from as many noises; a model without noise
    has one.

    Args:
        model: see `load_model`.
        observed: [N, obs_len, 2] metres.
        draws: number of futures n.
        seed: with `recording` and `frame`, determines the draws.
        recording: name of the recording.
        frame: index of the first observed step in the recording.
        repair: as in `predict`.
        place: what people did here before, which is watched with the same model; in its
            frame are `observed` and the futures.

    Returns:
        [n, N, pred_len, 2] float64 metres.

    Raises:
        InputError: as `predict`, and for a place of another model.
    """
    refuse(Count, {"draws": draws})
    scene = checked_scene(model, observed, recording, frame, repair)
    forecaster = SceneForecaster(
        model.forecaster, model.params, samples=1, seed=seed, repair=repair
    )
    memory = None if place is None else recalled_by(place, model, scene)
    return draw_futures(forecaster, scene, draws, memory)


def recalled_by(place: PlaceLike, model: Model, scene: Scene) -> Remembered:
    """What `place` recalls for the people of `scene`, padded as a forecast of it.

    Raises:
        InputError: if the place is watched with another model.
    """
    if place.model is not model:
        raise InputError("place: it is watched with another model")
    slots = int(bucket_of(len(scene.valid)))
    return place.recalled(to_world(scene.observed, scene), scene, slots)


def draw_futures(
    forecaster: SceneForecaster,
    scene: Scene,
    count: int,
    memory: Remembered | None = None,
) -> np.ndarray:
    """Draw `count` equally probable futures [n, N, pred_len, 2] of `scene`, world metres.

    With the `memory` of a place, `Place.recalled`, some are what people did there before.
    """
    slots = int(bucket_of(len(scene.valid)))
    refuse_many(forecaster.forecaster, count, slots)
    padded = forecaster.forecaster.prepared(pad_scene(scene.bare(), slots))
    futures = _draw_padded(
        forecaster.forecaster,
        forecaster.params,
        padded,
        forecaster.key,
        count,
        forecaster.repair,
        memory,
    )
    return to_world(np.asarray(futures)[:, : len(scene.valid)], scene)


@program((0, 4, 5), compiler_options=options_of)
def _draw_padded(
    forecaster: Forecaster,
    params: Any,
    scene: Scene,
    key: Array,
    count: int,
    repair: bool,
    memory: Remembered | None,
) -> Array:
    key = key_of(key)
    if not repair or forecaster.repairs:
        return forecaster.distribution(params, scene, key, count, memory)
    period = forecaster.config.period
    scene, repaired = repair_scene(scene, period)
    draws = forecaster.distribution(params, scene, key, count)
    draws = settle(draws, repaired, period)
    if memory is None:
        return draws
    return memory.among(draws, scene, key, count)


def checked_scene(
    model: Model, observed: ArrayLike, recording: str, frame: int, repair: bool = False
) -> Scene:
    """The scene that `predict` forecasts from `observed [N, obs_len, 2]`.

    Raises:
        InputError: as `predict`.
    """
    if isinstance(observed, Tracer):
        raise InputError(
            "predict runs on the host; under jit, vmap and grad call nj.forecast"
        )
    refuse_no_model(model)
    seen = None
    if model.forecaster.shortest < model.config.obs_len:
        observed, seen = whole_history(observed, model.config.obs_len, "observed")
    scene = make_scene(observed, recording=recording, frame=frame)
    refuse_other_length(model, scene.observed, "observed")
    if repair or model.forecaster.repairs:
        observed = np.asarray(scene.observed)
        warn_of_tracking_errors(observed, model.config.period)
    return scene.replace(seen=seen)


def warn_of_tracking_errors(
    observed: np.ndarray,
    period: float,
    named: Callable[[int], str] = str,
    source: str = "observed",
) -> bool:
    """Warn of agents in `observed [N, T, 2]` whose tracks are repaired; whether there are any.

    `named` gives what messages call an agent, and `source` all of them.

    Warns:
        InputWarning: naming the agents, and those without any plausible step.
    """
    repair = repair_tracks(observed, period)
    changed = was_repaired(observed, period)
    agents = _first_names(np.flatnonzero(changed & ~repair.lost), named)
    lost = _first_names(np.flatnonzero(repair.lost), named)
    texts = []
    if agents:
        texts.append(
            f"agents {agents} have steps that contradict those "
            "around them: taken for tracking errors and replaced"
        )
    if lost:
        texts.append(
            f"agents {lost} have no plausible step: they are "
            "forecast to go anywhere (are positions in metres?)"
        )
    if texts:
        warn_caller(f"{source}: {'; '.join(texts)}")
    return bool(texts)


def _first_names(agents: np.ndarray, named: Callable[[int], str]) -> str:
    """The first six of them, and an ellipsis for more."""
    names = [named(int(agent)) for agent in agents[:6]]
    if len(agents) > 6:
        names.append("...")
    return ", ".join(names)


def refuse_other_length(model: Model, observed: AnyArray, name: str) -> None:
    """Refuse `observed [N, T, 2]`, called `name`, if the model does not forecast from T steps.

    Raises:
        InputError: with both numbers.
    """
    steps, expected = observed.shape[1], model.config.obs_len
    if steps != expected and model.forecaster.shortest == expected:
        raise InputError(f"{name} has {steps} steps; the model observes {expected}")


@full_precision
def forecast(
    config: Any,
    params: Any,
    observed: ArrayLike,
    noise: ArrayLike | None = None,
    alpha: ArrayLike | None = None,
    *,
    valid: ArrayLike | None = None,
) -> Array:
    """k futures of one scene as a pure function, to differentiate by all but `config` and `valid`.

    It computes what `predict` does in the same coordinates, but nothing is padded,
    repaired (see `tracking_errors`) or moved to the host, and no values are checked: a
    position that is NaN gives NaN. Reverse mode only: the gradient of pooling is written
    by hand (`models.sgan.network`). Symbols with a hard threshold have a gradient of
    zero by positions; the weightings `soft` and `quantised` (straight through) have
    another.

    Args:
        config: `Model.config`.
        params: `Model.params`; those of a weighting, such as thresholds, are
            `params["weighting"]`.
        observed: [N, obs_len, 2] metres. Map coordinates lose precision in float32
            before this function sees them: subtract an origin, or use x64.
        noise: [k, noise_dim], or [k, N, noise_dim] where it is per agent; anchors take
            none and forecast all their samples.
        alpha: [N, N, obs_len], of which anchors use the last step; default: the model's
            own.
        valid: [N] bool, False for padding, whose positions are not looked at; default:
            no padding.

    Returns:
        [k, N, pred_len, 2] metres, in the frame of `observed`.

    Raises:
        InputError: without the noise that the forecaster takes, for another shape than
            these, and for parameters of another network. All is known when the function
            is traced.
    """
    if isinstance(config, Model):
        raise InputError("config is a Model: pass model.config, and model.params next")
    observed = jnp.asarray(observed)
    # A loop over steps keeps its type: that of the parameters.
    if not jnp.issubdtype(observed.dtype, jnp.floating) or observed.dtype.itemsize < 4:
        observed = observed.astype(jnp.float32)
    forecaster = forecaster_of(config)
    _refuse_shapes(forecaster, params, observed, noise, alpha, valid)
    present = checked_mask(valid, observed.shape[0])
    if valid is not None:  # Padding may hold anything, such as NaN.
        observed = jnp.where(present[:, None, None], observed, 0)
    scene, origin = _traced_scene(observed, present, alpha)
    if noise is None:
        samples = forecaster.count(getattr(config, "samples", 1))
        noise = jnp.zeros((samples, 0))
    samples = forecaster.forecast(params, scene, jnp.asarray(noise))
    forecaster.checked_futures(samples, (None, observed.shape[0]))
    return samples + origin[None, None, None]


def _traced_scene(
    observed: Array, present: Array, alpha: ArrayLike | None
) -> tuple[Scene, Array]:
    """The scene of `forecast`, and its origin [2]: the mean of who is `present [N]`."""
    last = observed[:, -1]
    # For precision only: a network sees differences of positions.
    share = present.astype(observed.dtype)
    origin = jax.lax.stop_gradient(share @ last / jnp.maximum(share.sum(), 1))
    scene = Scene(
        observed=observed - origin[None, None],
        displacement=moves_of(observed),
        valid=present,
        identity=jnp.zeros(2, jnp.uint32),
        origin=None,
        alpha=None if alpha is None else jnp.asarray(alpha),
    )
    return scene, origin


def _refuse_shapes(
    forecaster: Forecaster,
    params: Any,
    observed: Array,
    noise: ArrayLike | None,
    alpha: ArrayLike | None,
    valid: ArrayLike | None,
) -> None:
    """Refuse arguments of `forecast` by their shapes alone: nothing is computed.

    Raises:
        InputError: naming the argument, its shape and the one expected.
    """
    # Sizes may be symbols of an export, which are compared but not converted.
    steps = forecaster.config.obs_len
    shape = jnp.shape(observed)
    fits = len(shape) == 3 and shape[2] == 2
    if not fits or (shape[1] != steps and forecaster.shortest == steps):
        hint = ""
        if len(shape) == 3 and shape[0] == steps and shape[2] == 2:
            hint = "; steps come second: observed.swapaxes(0, 1)"
        raise InputError(
            f"observed is {_text(shape)}, and the model takes [N, {steps}, 2]{hint}"
        )
    agents = shape[0]
    checked_mask(valid, agents)
    if alpha is not None:
        _refuse_alpha(forecaster, jnp.shape(alpha), agents, steps)

    spec = forecaster.noise
    axes = (agents, spec.dim) if spec.per_agent else (spec.dim,)
    if noise is None and spec.dim:
        raise InputError(f"noise: this forecaster needs one, [k, {_text(axes)[1:]}")
    if noise is not None:
        noise_shape = jnp.shape(noise)
        if len(noise_shape) != len(axes) + 1 or noise_shape[1:] != axes:
            expected = f"[k, {_text(axes)[1:]}" if spec.dim else "none"
            raise InputError(
                f"noise is {_text(noise_shape)}, and the model takes {expected}"
            )
    _refuse_params(forecaster, params)


def _refuse_params(forecaster: Forecaster, params: Any) -> None:
    """Refuse parameters of `forecast` of other names or shapes than `init` makes.

    Raises:
        InputError: naming the first of them.
    """
    shapes = forecaster.shapes()
    if shapes is None:
        return
    if not isinstance(params, Mapping):
        kind = type(params).__name__
        raise InputError(f"params must be those of a model, dictionaries, not {kind}")
    expected = shapes_of(shapes)
    given = shapes_of(params)
    weighting = getattr(forecaster.config, "weighting", None)
    if isinstance(weighting, Weighting):
        weighting.refuse_parameters(params.get("weighting", {}))
        # It has said what it takes, which may be more than it learns.
        given, expected = (
            {name: shape for name, shape in table.items() if not _of_weighting(name)}
            for table in (given, expected)
        )
    refuse_other_shapes(given, expected, "params are those of another network")


def _of_weighting(name: str) -> bool:
    return name.startswith("weighting/")


def _refuse_alpha(
    forecaster: Forecaster, shape: tuple[Any, ...], agents: Any, steps: int
) -> None:
    if not getattr(forecaster.config, "symbolic", True):
        raise InputError(
            f"alpha: {forecaster.title} weights no pairs; leave it out, or take "
            "pooling='as_described'"
        )
    if shape != (agents, agents, steps):
        raise InputError(
            f"alpha is {_text(shape)}, and the model takes [{agents}, {agents}, {steps}]"
        )


def _text(shape: tuple[Any, ...]) -> str:
    return f"[{', '.join(map(str, shape))}]"


# Forecasts of many scenes at once: batches, and agents packed without padding.
#
# If a forecaster's decoding looks at no neighbour, the agents of a batch of padded scenes
# are decoded as one scene without padding, in parts of one size: no work is spent on
# padding, and one compiled program serves scenes of every size. Single scenes are
# `model`'s.

PART = 128
"""Agents decoded in one call: with 20 samples their states stay in the second-level cache."""


@dataclasses.dataclass(frozen=True, eq=False)
class _Part:
    """A scene as it was given, and its people."""

    name: str
    """What messages call it."""
    people: ArrayLike
    """[n, obs_len, 2] those who are there."""
    valid: np.ndarray | None
    """[N] bool, n true; None for a scene without padding."""

    @property
    def is_empty(self) -> bool:
        """Whether all of it is padding."""
        return self.valid is not None and not self.valid.any()

    def placed(self, futures: np.ndarray) -> np.ndarray:
        """Futures [k, n, ...] in the slots of the scene, [k, N, ...]: NaN in padding."""
        if self.valid is None:
            return futures
        shape = len(futures), len(self.valid), *futures.shape[2:]
        places = np.full(shape, np.nan)
        places[:, self.valid] = futures
        return places


def _parts(
    scenes: Iterable[ArrayLike], valid: Iterable[ArrayLike] | None, name: str
) -> Iterator[_Part]:
    """Scenes with those who are there; `name` has a place for the scene's number.

    Raises:
        InputError: for another number of masks than scenes, or a mask of another shape
            or type.
    """
    if valid is None:
        for number, scene in enumerate(scenes):
            yield _Part(name.format(number), scene, None)
        return
    missing = object()
    pairs = itertools.zip_longest(scenes, valid, fillvalue=missing)
    for number, (scene, present) in enumerate(pairs):
        if scene is missing or present is missing:
            raise InputError(f"valid: has another length than the scenes, at {number}")
        # A masked array stays one, for the check of those who are there.
        positions, mask = np.asanyarray(scene), np.asarray(present)
        if mask.dtype != bool or mask.shape != positions.shape[:1]:
            raise InputError(
                f"valid of {name.format(number)} must be bool "
                f"{list(positions.shape[:1])}, not {mask.dtype} {list(mask.shape)}"
            )
        yield _Part(name.format(number), positions[mask], mask)


def predict_scenes(
    model: Model,
    observed: Iterable[ArrayLike],
    *,
    samples: int = 20,
    seed: int = 0,
    recording: str = "",
    frames: Sequence[int] | None = None,
    repair: bool = False,
    valid: Iterable[ArrayLike] | None = None,
) -> list[np.ndarray]:
    """`predict` for many scenes `[N_i, obs_len, 2]`, scenes of one padded size at once.

    Forecast i equals `predict(model, observed[i], frame=frames[i], ...)` up to float
    rounding; `frames` are 0, 1, 2, ... by default, `repair` is that of `predict`, and
    `valid` that of `predict_batches`. All forecasts are in memory together, 16 pred_len
    bytes for each sample of a person; `predict_batches` streams larger numbers of
    scenes.

    Returns:
        For each scene `[k, N_i, pred_len, 2]` float64 metres in its own frame.

    Raises:
        InputError: naming the scene that `predict` would refuse; for another number of
            frames than scenes.
    """
    refuse(Count, {"samples": samples})
    parts = list(_parts(observed, valid, "observed[{}]"))
    frames = range(len(parts)) if frames is None else frames
    if len(frames) != len(parts):
        raise InputError(f"{len(frames)} frames are given for {len(parts)} scenes")
    futures, _ = _predict_parts(
        model,
        parts,
        frames,
        samples=samples,
        seed=seed,
        recording=recording,
        repair=repair,
    )
    return futures


STREAMED = 512
"""Scenes of a stream that are forecast together."""


def predict_batches(
    scenes: Iterable[ArrayLike],
    model: Model,
    *,
    valid: Iterable[ArrayLike] | None = None,
    samples: int = 20,
    seed: int = 0,
    recording: str = "",
    repair: bool = False,
) -> Iterator[np.ndarray]:
    """`predict` for a stream of scenes without end, in bounded memory.

    Forecast i equals `predict(model, scene, frame=i, ...)` up to float rounding, however
    the scenes arrive.

    Args:
        scenes: [N_i, obs_len, 2] metres each, such as a generator or an array
            [S, N, obs_len, 2]; read as they are needed.
        model: see `load_model`.
        valid: [N_i] bool for each scene, False for padding, such as an array [S, N];
            default: no padding.
        samples: number of futures k.
        seed: with `recording` and the number of a scene, determines its noise.
        recording: name of the recording.
        repair: see `predict`.

    Yields:
        For each scene [k, N_i, pred_len, 2] float64 metres in its own frame, NaN in
        padding.

    Raises:
        InputError: as `predict_scenes`, when the scene is reached.
    """
    parts, done = _parts(scenes, valid, "scene {}"), 0
    warned = False
    while True:
        some = list(itertools.islice(parts, STREAMED))
        if not some:
            return
        futures, repaired = _predict_parts(
            model,
            some,
            range(done, done + len(some)),
            samples=samples,
            seed=seed,
            recording=recording,
            repair=repair,
            # A stream without end would fill the terminal, and the list of warnings.
            quiet=warned,
        )
        warned |= repaired
        yield from futures
        done += len(some)


def _predict_parts(
    model: Model,
    parts: Sequence[_Part],
    frames: Sequence[int],
    *,
    samples: int,
    seed: int,
    recording: str,
    repair: bool,
    quiet: bool = False,
) -> tuple[list[np.ndarray], bool]:
    """`predict_scenes` of parts, and whether it warned of tracking errors, unless `quiet`.

    A scene that is all padding needs no forecast.
    """
    warned = False
    refuse_no_model(model)
    _refuse_params(model.forecaster, model.params)
    count = model.forecaster.count(samples)
    nobody = np.empty((count, 0, model.forecaster.pred_len, 2))
    futures = [nobody] * len(parts)
    filled = [number for number, part in enumerate(parts) if not part.is_empty]
    if filled:
        named = {parts[number].name: parts[number].people for number in filled}
        numbers = np.asarray([frames[number] for number in filled])
        identity = scene_identity(recording, numbers)
        windows = _windows_of(model, named, identity)
        period = model.config.period
        repaired = repair_tracks(windows.position, period) if repair else None
        if (repair or model.forecaster.repairs) and not quiet:
            source, agent_name = parts[0].name, str
            if len(parts) > 1:
                source = f"{len(parts)} scenes"
                agent_name = functools.partial(_name_of_agent, [*named], windows.bounds)
            warned = warn_of_tracking_errors(
                windows.position, period, agent_name, source
            )
        if repaired is not None:
            windows = dataclasses.replace(windows, position=repaired.tracks)
        batches = make_batches(windows)
        together, _ = forecast_windows(model, windows, batches, samples, seed)
        if repaired is not None:
            together = settle(together, repaired, period)
        forecasts = np.split(together, windows.bounds[1:-1], axis=1)
        for number, forecast in zip(filled, forecasts):
            futures[number] = forecast
    placed = [part.placed(future) for part, future in zip(parts, futures)]
    return placed, warned


def _name_of_agent(scenes: Sequence[str], bounds: np.ndarray, agent: int) -> str:
    """What messages call a row of the `scenes` together, which end at `bounds [S + 1]`."""
    scene = int(np.searchsorted(bounds, agent, side="right")) - 1
    return f"{agent - bounds[scene]} of {scenes[scene]}"


def _windows_of(
    model: Model, named: Mapping[str, ArrayLike], identity: np.ndarray
) -> Windows:
    """Observed windows of scenes by the names that messages call them.

    Raises:
        InputError: as `predict_scenes`.
    """
    seen = None
    if model.forecaster.shortest < model.config.obs_len:
        named, seen = _whole_histories(named, model.config.obs_len)
    scenes = [checked_positions(name, scene) for name, scene in named.items()]
    for name, scene in zip(named, scenes):
        refuse_other_length(model, scene, name)
    bounds = np.cumsum([0, *map(len, scenes)])
    tracks, agents = np.concatenate(scenes), np.arange(bounds[-1])
    return Windows(tracks, agents, bounds, identity, model.config.obs_len, seen=seen)


def _whole_histories(
    named: Mapping[str, ArrayLike], steps: int
) -> tuple[Mapping[str, ArrayLike], np.ndarray | None]:
    """See `whole_history`: scenes by name, and what was seen of all agents, [A, steps]."""
    scenes: dict[str, ArrayLike] = {}
    parts = []
    for name, observed in named.items():
        scenes[name], seen = whole_history(observed, steps, name)
        if seen is None:
            agents = len(np.asarray(scenes[name]))
            seen = np.ones((agents, steps), bool)
        parts.append(seen)
    together = np.concatenate(parts)
    return scenes, None if together.all() else together


def forecast_windows(
    model: Model,
    windows: Windows,
    batches: Sequence[Batch],
    samples: int,
    seed: int,
    run: Callable[..., Iterable[Any]] = map,
) -> tuple[np.ndarray, np.ndarray | None]:
    """Futures of the A agents and probabilities of the S scenes of `windows`.

    `batches` are all windows; `run` is `map` or an executor's, and applies a function
    to batches.

    Returns:
        [k, A, pred_len, 2] float64 world metres and [k, S]; None where all are the
        same.
    """
    forecaster = model.forecaster
    samples = forecaster.count(samples)
    refuse_many(forecaster, samples, windows.agents, min(windows.agents, PART))
    params = jax.device_put(model.params)
    places = np.empty((samples, windows.agents, forecaster.pred_len, 2))
    likely = np.empty((samples, windows.scenes))

    def of_batch(batch: Batch) -> tuple[np.ndarray, np.ndarray | None]:
        noise = batch_noise(forecaster, batch.scene, samples, seed)
        return forecast_batch(forecaster, params, batch.scene, noise)

    probability = None
    for batch, (futures, probability) in zip(batches, run(of_batch, batches)):
        present = batch.index >= 0
        scenes = batch.index[present]
        if probability is not None:
            likely[:, scenes] = probability[:, present]
        origins = np.asarray(batch.scene.origin)[present]
        origin = np.repeat(origins, windows.sizes[scenes], axis=0)
        places[:, windows.rows(scenes)] = futures + origin[:, None]
    return places, None if probability is None else likely


def batch_noise(
    forecaster: Forecaster, scenes: Scene, samples: int, seed: int
) -> np.ndarray:
    """Noise of a batch of B scenes, `[k, B, dim]` or `[k, B, N, dim]`."""
    identity = np.asarray(scenes.identity)
    slots = scenes.valid.shape[1]
    return draw_noise(forecaster.noise, seed, identity, samples, slots)


def forecast_batch(
    forecaster: Forecaster, params: Any, scenes: Scene, noise: np.ndarray
) -> tuple[np.ndarray, np.ndarray | None]:
    """Futures of the A valid agents of a batch of B scenes, and probabilities of the scenes.

    `noise` is `[k, B, dim]` or `[k, B, N, dim]`, see `batch_noise`.

    Returns:
        [k, A, pred_len, 2] metres relative to each scene's origin, and [k, B]; None
        where all are the same.
    """
    valid = np.asarray(scenes.valid)
    if isinstance(forecaster, TwoStageForecaster) and forecaster.decodes_alone:
        return _decoded_agents(forecaster, params, scenes, noise, valid), None
    futures, likely = _forecast(forecaster, params, scenes.bare(), noise)
    futures = np.asarray(futures)[:, valid]
    return futures, None if likely is None else np.asarray(likely)


def draw_batch(
    forecaster: Forecaster,
    params: Any,
    scenes: Scene,
    seed: int,
    count: int,
    memory: Remembered | None = None,
) -> np.ndarray:
    """Independent draws of a batch of B scenes, [n, B, N, pred_len, 2].

    See `Forecaster.independent_draws`; a forecaster without noise and distribution has
    one. A `memory` has a leading axis B, too.
    """
    refuse(Seed, {"seed": seed})
    key = key_numbers(seed)
    draws = _draws(forecaster, params, scenes.bare(), key, count, memory)
    return np.asarray(draws)


def _decoded_agents(
    forecaster: TwoStageForecaster,
    params: Any,
    scenes: Scene,
    noise: np.ndarray,
    valid: np.ndarray,
) -> np.ndarray:
    """`[k, A, pred_len, 2]` of the agents, packed as one scene and decoded in parts of `PART`."""
    encoder = forecaster.encoder
    bare = scenes.bare()
    context = () if encoder is None else _encode(encoder, params, bare)
    agents = context, bare.replace(identity=None)
    agents = jax.tree.map(lambda leaf: np.asarray(leaf)[valid], agents)
    if noise.ndim == 4:
        agent_noise = noise[:, valid]
    else:
        agent_noise = np.repeat(noise, valid.sum(axis=1), axis=1)
    packed = (*agents, agent_noise.swapaxes(0, 1))
    count = agent_noise.shape[1]
    parts = []
    for begin in range(0, count, PART):
        rows = slice(begin, begin + PART)
        part = jax.tree.map(lambda leaf, rows=rows: _filled(leaf[rows]), packed)
        *agent_part, noise_part = part
        futures = _decode(forecaster, params, *agent_part, noise_part.swapaxes(0, 1))
        parts.append(np.asarray(futures)[:, : count - begin])
    return np.concatenate(parts, axis=1)


def _filled(rows: np.ndarray) -> np.ndarray:
    """`rows` with zeros up to `PART` of them along the first axis."""
    part = np.zeros((PART, *rows.shape[1:]), rows.dtype)
    part[: len(rows)] = rows
    return part


def unpacked(futures: np.ndarray, valid: np.ndarray) -> np.ndarray:
    """`futures [k, A, ...]` in their slots `valid [B, N]`: `[k, B, N, ...]`, zero in padding."""
    shape = len(futures), *valid.shape, *futures.shape[2:]
    places = np.zeros(shape, futures.dtype)
    places[:, valid] = futures
    return places


@program((0,), compiler_options=options_of)
def _forecast(forecaster, params, scenes, noise):
    axes = (None, 0, 1)
    forecast = jax.vmap(forecaster.representatives, in_axes=axes, out_axes=1)
    return forecast(params, scenes, noise)


@program((0, 4), compiler_options=options_of)
def _draws(forecaster, params, scenes, key, count, memory):
    key = key_of(key)

    def drawn(scene_and_memory):
        scene, memory = scene_and_memory
        return forecaster.independent_draws(params, scene, key, count, memory)

    # One after the other: what a scene's pairs say is large, and most pairs say nothing.
    return jax.lax.map(drawn, (scenes, memory)).swapaxes(0, 1)


@program((0,))
def _encode(encoder, params, scenes):
    return jax.vmap(encoder.encode, in_axes=(None, 0))(params, scenes)


@program((0,))
def _decode(forecaster, params, context, agents, noise):
    return forecaster.decode(params, context, agents, noise)
