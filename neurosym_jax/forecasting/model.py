"""A trained model, and its forecasts of single scenes, in the world's frame."""

import dataclasses
import hashlib
import json
import reprlib
import warnings
from collections.abc import Mapping
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.core import Tracer
from jax.typing import ArrayLike

from neurosym_jax.configuration import Count, Seed, differences, refuse, to_json
from neurosym_jax.data.windows import bucket_of
from neurosym_jax.errors import InputError, InputWarning
from neurosym_jax.forecasting.forecaster import (
    FORECASTERS,
    Forecaster,
    Representatives,
    forecaster_of,
    refuse_many,
)
from neurosym_jax.forecasting.noise import key_numbers, key_of, scene_noise
from neurosym_jax.forecasting.tracking_errors import repair_tracks, was_repaired
from neurosym_jax.runtime.process import COMPILED_QUICKLY
from neurosym_jax.runtime.programs import program
from neurosym_jax.scene import AnyArray, Scene, make_scene, pad_scene, to_world
from neurosym_jax.symbolic.weighting import Weighting

__all__ = [
    "Model",
    "SceneForecaster",
    "checked_scene",
    "forecast",
    "forecast_scene",
    "predict",
]
__all__ += ["predict_representatives", "refuse_other_length", "warn_of_tracking_errors"]


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
    """Fingerprint of its training windows, see `data.leakage`; empty where it is not known."""
    data: Mapping[str, str] = dataclasses.field(default_factory=dict)
    """Licence of each data set that it learned from, by name; empty where not known."""
    step: int | None = None
    """Steps of training after which its parameters were kept; None where it is not known."""
    recipe: str = ""
    """Digest of its recipe without the seed; empty where it is not known."""

    @property
    def name(self) -> str:
        """Name in tables: the forecaster's title."""
        return self.forecaster.title

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
        leaves = jax.tree.leaves(self.params)
        return {
            "configuration": _digest(json.dumps(trained, sort_keys=True).encode()),
            "training_data": _digest(self.seen.encode()) if self.seen else None,
            "training_seed": self.seed,
            "parameters": _digest(*(np.asarray(leaf).tobytes() for leaf in leaves)),
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


def _digest(*contents: bytes) -> str:
    sha = hashlib.sha256()
    for content in contents:
        sha.update(content)
    return sha.hexdigest()[:16]


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
        """Move `params` to the device; nothing is compiled yet.

        With `repair`, every forecaster is given plausible tracks in place of tracking
        errors, see `repair_tracks`.
        """
        refuse(Count, {"samples": samples})
        refuse(Seed, {"seed": seed})
        self.forecaster = forecaster
        self.samples = forecaster.count(samples)
        refuse_many(forecaster, self.samples, 1)
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
        world = to_world(np.asarray(futures)[:, : len(scene.valid)], scene)
        return world, None if probability is None else np.asarray(
            probability, np.float64
        )


@program((0, 4))
def forecast_scene(
    forecaster: Forecaster,
    params: Any,
    scene: Scene,
    noise: Any,
    repair: bool = False,
) -> Representatives:
    """`forecaster.representatives`, compiled; equal forecasters share the program.

    With `repair`, its `repaired_representatives`.
    """
    if repair:
        return forecaster.repaired_representatives(params, scene, noise)
    return forecaster.representatives(params, scene, noise)


# Apart from the forecast, because threefry is slow to compile and this serves every
# bucket.
@program((0, 3, 4), compiler_options=COMPILED_QUICKLY)
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
) -> np.ndarray:
    """Forecast one scene in the caller's own frame.

    Args:
        model: see `load_model`.
        observed: [N, obs_len, 2] metres.
        samples: number of futures k; a deterministic model makes one.
        seed: with `recording` and `frame`, determines the noise.
        recording: name of the recording.
        frame: index of the first observed step in the recording.
        repair: give plausible tracks in place of tracking errors (see `repair_tracks`)
            to a network that takes positions as they are, SGAN's or NeuroSyM's. Anchors
            always see plausible tracks.

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
    return futures, np.full(
        len(futures), 1 / len(futures)
    ) if probability is None else probability


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
    scene = make_scene(observed, recording=recording, frame=frame)
    refuse_other_length(model, scene.observed, "observed")
    if repair or model.forecaster.repairs:
        observed = np.asarray(scene.observed)
        warn_of_tracking_errors(observed, model.config.period, "observed", 4)
    return scene


def warn_of_tracking_errors(
    observed: np.ndarray, period: float, name: str, stacklevel: int = 3
) -> None:
    """Warn of agents in `observed [N, T, 2]`, called `name`, whose tracks are repaired.

    Warns:
        InputWarning: naming the agents, and those without any plausible step.
    """
    repair = repair_tracks(observed, period)
    changed = was_repaired(observed, period)
    agents = np.flatnonzero(changed & ~repair.lost).tolist()
    lost = np.flatnonzero(repair.lost).tolist()
    texts = []
    if agents:
        texts.append(
            f"agents {reprlib.repr(agents)[1:-1]} have steps that contradict those "
            "around them: taken for tracking errors and replaced"
        )
    if lost:
        texts.append(
            f"agents {reprlib.repr(lost)[1:-1]} have no plausible step: they are "
            "forecast to go anywhere (are positions in metres?)"
        )
    if texts:
        warnings.warn(f"{name}: {'; '.join(texts)}", InputWarning, stacklevel)


def refuse_other_length(model: Model, observed: AnyArray, name: str) -> None:
    """Refuse `observed [N, T, 2]`, called `name`, if the model does not observe T steps.

    Raises:
        InputError: with both numbers.
    """
    steps, expected = observed.shape[1], model.config.obs_len
    if steps != expected:
        raise InputError(f"{name} has {steps} steps; the model observes {expected}")


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
    checked, repaired (see `tracking_errors`) or moved to the host. Reverse mode only:
    the gradient of pooling is written by hand (`models.sgan.pooling`). Symbols with a
    hard threshold have a gradient of zero by positions; the weightings `soft` and
    `quantised` (straight through) have another.

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
        valid: [N] bool, False for padding; default: no padding.

    Returns:
        [k, N, pred_len, 2] metres, in the frame of `observed`.

    Raises:
        InputError: without the noise that the forecaster takes.
    """
    observed = jnp.asarray(observed)
    if (
        observed.dtype.itemsize < 4
    ):  # A loop over steps keeps its type: that of the parameters.
        observed = observed.astype(jnp.float32)
    last = observed[:, -1]
    present = jnp.ones(last.shape[0], bool) if valid is None else jnp.asarray(valid)
    # For precision only: a network sees differences of positions.
    share = present.astype(observed.dtype)
    origin = jax.lax.stop_gradient(share @ last / jnp.maximum(share.sum(), 1))
    forecaster = forecaster_of(config)
    if noise is None:
        if forecaster.noise.dim:
            raise InputError(
                "noise: this forecaster needs one, [k, dim] or [k, N, dim]"
            )
        noise = jnp.zeros((forecaster.count(getattr(config, "samples", 1)), 0))
    scene = Scene(
        observed=observed - origin[None, None],
        displacement=jnp.diff(observed, axis=1, prepend=observed[:, :1]),
        valid=present,
        identity=jnp.zeros(2, jnp.uint32),
        origin=None,
        alpha=None if alpha is None else jnp.asarray(alpha),
    )
    samples = forecaster.forecast(params, scene, jnp.asarray(noise))
    return samples + origin[None, None, None]
