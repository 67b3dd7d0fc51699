"""What a forecaster is: k samples of one scene, given noise; and the table of families.

A family is a subclass of `Forecaster` in one folder of `models`, or in a plugin: it
owns its configurations, recipes, parameters, forecast, batches and loss. Nothing
outside asks which it is.

Equal forecasters are equal to `jax.jit`, so they share compiled programs.
"""

import abc
import dataclasses
import functools
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from neurosym_jax.configuration import Checked, Rule, Seed, Size, differences, refuse
from neurosym_jax.errors import InputError
from neurosym_jax.plugins import Registry, additions
from neurosym_jax.runtime.process import (
    COMPILED_UNFUSED,
    refuse_beyond_memory,
    refuse_forked,
)
from neurosym_jax.runtime.programs import kept_json, program
from neurosym_jax.scene import Scene
from neurosym_jax.symbolic.weighting import Weighting, initial_parameters

if TYPE_CHECKING:
    from neurosym_jax.models.place.mixture import Remembered
from neurosym_jax.errors import brief

__all__ = [
    "FORECASTERS",
    "Forecaster",
    "Lengths",
    "NoiseSpec",
    "Representatives",
    "TwoStageForecaster",
    "checked_key",
    "draw_noise",
    "flat_parameters",
    "forecaster_of",
    "key_numbers",
    "key_of",
    "leaves_by_path",
    "nested_parameters",
    "refuse_many",
    "refuse_misfit",
    "refuse_other_shapes",
    "refuse_other_tree",
    "register_forecaster",
    "scene_noise",
    "shapes_of",
    "with_weighting",
]


# Parameters as arrays by path, such as `params/mlp/bias`, and the check that they fit.

DEPTH = 32
"""Parts of a path; jax's trees overflow the stack at some ten thousand."""


def flat_parameters(params: Any) -> dict[str, np.ndarray]:
    """The arrays of nested dictionaries by path.

    Raises:
        InputError: for a tree that would not come back: not dictionaries, empty ones,
            names with a `/`, leaves that are not arrays of numbers.
    """
    refuse_other_tree(params)
    flat = {name: np.asarray(leaf, order="C") for name, leaf in leaves_by_path(params)}
    for name, array in flat.items():
        if array.dtype.kind not in "fiub" or array.dtype.itemsize > 8:
            raise InputError(f"the parameter {name} is not an array of numbers")
    return flat


def refuse_other_tree(params: Any) -> None:
    """Refuse what is no tree of nested dictionaries, as of an Equinox module.

    Raises:
        InputError: for a tree that would not come back from its paths.
    """
    again = nested_parameters(dict(leaves_by_path(params)))
    if jax.tree.structure(again) != jax.tree.structure(params):
        raise InputError(
            "parameters must be nested dictionaries of arrays, by names without a '/'"
        )


def nested_parameters(flat: Mapping[str, Any]) -> dict[str, Any]:
    """The inverse of `flat_parameters`.

    Raises:
        InputError: for paths of more than `DEPTH` parts, and two of which one begins
            the other.
    """
    params: dict[str, Any] = {}
    for path, value in flat.items():
        *scope, name = path.split("/")
        if len(scope) >= DEPTH:
            raise InputError(
                f"the parameter {brief(path)} has a path of {len(scope) + 1} parts"
            )
        node = params
        for part in scope:
            node = node.setdefault(part, {})
            if not isinstance(node, dict):
                break
        if not isinstance(node, dict) or name in node:
            raise InputError(
                f"{brief(path)}: the name of a parameter and of a folder of others"
            )
        node[name] = value
    return params


def shapes_of(params: Any) -> dict[str, tuple[int, ...]]:
    """Shapes of the arrays [...] of nested dictionaries by path."""
    return {name: jnp.shape(leaf) for name, leaf in leaves_by_path(params)}


def refuse_misfit(
    arrays: Mapping[str, np.ndarray], expected: Mapping[str, Any], message: str
) -> None:
    """Refuse arrays [...] whose names and shapes are not those `expected`, or that are not finite.

    Raises:
        InputError: naming the first of them; `message` is what it says of misfits.
    """
    refuse_other_shapes(shapes_of(arrays), expected, message)
    infinite = [name for name, array in arrays.items() if not np.isfinite(array).all()]
    if infinite:
        raise InputError(f"parameters that are not finite: {_first_of(infinite)}")


def refuse_other_shapes(
    shapes: Mapping[str, Any], expected: Mapping[str, Any], message: str
) -> None:
    """Refuse shapes of arrays by name that are not those `expected`.

    Raises:
        InputError: naming the first of them, after `message`.
    """
    misfits = [
        f"{brief(name)} is {shapes.get(name, 'missing')}, "
        f"not {expected.get(name, 'expected')}"
        for name in {**expected, **shapes}
        if shapes.get(name) != expected.get(name)
    ]
    if misfits:
        raise InputError(f"{message}: {_first_of(misfits)}")


def _first_of(names: list[str]) -> str:
    rest = f" and {len(names) - 6} more" if len(names) > 6 else ""
    return f"{', '.join(names[:6])}{rest}"


def leaves_by_path(params: Any) -> list[tuple[str, Any]]:
    """Path and leaf of each array of nested dictionaries."""
    leaves = jax.tree_util.tree_leaves_with_path(params)
    return [
        (jax.tree_util.keystr(path, simple=True, separator="/"), leaf)
        for path, leaf in leaves
    ]


# The noise of stochastic forecasters.
#
# Noise is a function of (seed, scene, sample, slot), the same however scenes are batched.
# Each scene, or each agent slot where noise is per agent, has its own stream of random
# numbers. A sample's numbers do not depend on how many samples are drawn, which is a
# property of JAX's partitionable threefry (element i of an array depends on i alone) that
# the tests check.

CHUNK = 1024
"""Streams drawn in one call, so that one compiled program serves any number of scenes."""


@dataclasses.dataclass(frozen=True)
class NoiseSpec:
    """The noise that a forecaster takes for each sample; a deterministic one has `dim` 0."""

    dim: int = 0
    per_agent: bool = False
    distribution: Literal["gaussian", "uniform"] = "gaussian"
    """Standard normal, or uniform on [-1, 1)."""

    def draw(self, key: Array, shape: tuple[int, ...], dtype: Any = float) -> Array:
        """Numbers [*shape] of the distribution; consumes `key`."""
        if self.distribution == "gaussian":
            return jax.random.normal(key, shape, dtype)
        return jax.random.uniform(key, shape, dtype, minval=-1.0, maxval=1.0)


def scene_noise(
    spec: NoiseSpec, key: Array, identity: Array, samples: int, agents: int
) -> Array:
    """Noise of one scene, [k, dim] or per agent [k, N, dim].

    `key` is the run's, the same for every scene, and is not consumed; `identity` is
    `Scene`'s.
    """
    draw = functools.partial(_stream, spec, key, identity, samples=samples)
    if spec.per_agent:
        slots = jnp.arange(agents, dtype=jnp.uint32)
        return jax.vmap(draw, out_axes=1)(slots)
    return draw(jnp.uint32(0))


def draw_noise(
    spec: NoiseSpec, seed: int, identity: np.ndarray, samples: int, agents: int
) -> np.ndarray:
    """`scene_noise` of B scenes, `identity [B, 2]`: [k, B, dim] or [k, B, N, dim] on the host.

    Raises:
        InputError: for a seed outside [0, 2**32), which JAX would silently wrap.
    """
    refuse(Seed, {"seed": seed})
    slots = (agents,) if spec.per_agent else ()
    shape = (samples, len(identity), *slots, spec.dim)
    if spec.dim == 0:
        return np.zeros(shape, np.float32)
    per_scene = slots[0] if slots else 1
    scene = np.repeat(identity, per_scene, axis=0)
    slot = np.tile(np.arange(per_scene, dtype=np.uint32), len(identity))
    streams = np.column_stack([scene, slot])
    key = key_numbers(seed)
    parts = []
    for chunk in np.split(streams, range(CHUNK, len(streams), CHUNK)):
        filled = np.zeros((CHUNK, 3), np.uint32)
        filled[: len(chunk)] = chunk
        noise = _streams(spec, key, filled[:, :2], filled[:, 2], samples)
        parts.append(np.asarray(noise))
    noise = np.concatenate(parts, axis=1)[:, : len(slot)]
    return noise.reshape(shape)


def key_numbers(seed: int) -> np.ndarray:
    """[2] uint32: the numbers of `jax.random.key(seed)`, on the host."""
    return np.array([0, seed], np.uint32)


def key_of(numbers: Array) -> Array:
    """The key of `key_numbers [2]`, made within a program: outside, it would be one of its own."""
    return jax.random.wrap_key_data(numbers, impl="threefry2x32")


def _stream(
    spec: NoiseSpec, key: Array, identity: Array, slot: Array, samples: int
) -> Array:
    for part in (identity[0], identity[1], slot):
        key = jax.random.fold_in(key, part)
    # Always float32: under x64 the default type would be float64, which has other
    # numbers.
    return spec.draw(key, (samples, spec.dim), jnp.float32)


@program((0, 4), compiler_options=COMPILED_UNFUSED)
def _streams(spec, key, identity, slot, samples):
    draw = functools.partial(_stream, spec, key_of(key), samples=samples)
    return jax.vmap(draw, out_axes=1)(identity, slot)


# Forecasters, and the table of families.

POINTS = 64
"""Draws that stand for each person's distribution, where a forecaster has no points."""

Representatives = tuple[Array, Array | None]
"""Samples [k, N, pred_len, 2] of a scene and their probabilities [k]; None where all have the
same."""


@dataclasses.dataclass(frozen=True)
class Lengths(Checked):
    """The configuration of a forecaster that needs nothing else, and a part of all others."""

    obs_len: Size = 8
    """Observed time steps."""
    pred_len: Size = 8
    """Time steps to forecast."""
    period: Annotated[
        float, Rule("lie in (0, 3600]", lambda value: 0 < value <= 3600)
    ] = 0.4
    """Seconds between time steps, in training."""


@dataclasses.dataclass(frozen=True)
class Forecaster(abc.ABC):
    """A forecast of one scene, as a function of parameters, scene and noise."""

    config: Any
    """Configuration, of type `Config`."""

    Config: ClassVar[type] = Lengths
    """A frozen dataclass with at least the fields of `Lengths`."""
    configs: ClassVar[Mapping[str, Any]] = {}
    """Configurations by the name of the model; without any, the default one by the family's key."""
    recipes: ClassVar[Mapping[str, Any]] = {}
    """Recipes of training by name, the usual one first; without any, `training.recipe.Recipe`."""
    compiler_options: ClassVar[Mapping[str, Any]] = {}
    """How XLA compiles its forecasts for a CPU; see `jax.jit`."""

    @property
    def key(self) -> str:
        """The family's name in files and options: the one that it is registered by."""
        return FORECASTERS.name_of(self)

    @property
    def title(self) -> str:
        """What tables call it; by default the name of the class. Free to change."""
        return type(self).__name__

    @property
    def model(self) -> str:
        """The name in `configs` of what this configuration is; by default the first."""
        return next(iter(self.configs), self.key)

    @property
    def variant(self) -> str:
        """A name for files that tells apart models trained on the same data."""
        lengths = ("obs_len=", "pred_len=", "period=")
        parts = [self.model]
        for change in differences(self.config):
            if not change.startswith(lengths):
                parts.append(change.replace("=", "_"))
        return "_".join(parts)

    @property
    def pred_len(self) -> int:
        """Time steps that are forecast."""
        return self.config.pred_len

    @property
    def noise(self) -> NoiseSpec:
        """The noise it takes; by default none, a deterministic forecast."""
        return NoiseSpec()

    @property
    def state_size(self) -> int:
        """Numbers that decoding one sample of one agent takes besides the future itself."""
        return 0

    @property
    def sees_neighbours(self) -> bool:
        """Whether a forecast should depend on who else is in the scene."""
        return True

    @property
    def shortest(self) -> int:
        """Fewest observed steps of an agent that it forecasts; by default all of `obs_len`.

        Where it is less, histories may have gaps, and further steps at their beginning.
        """
        return self.config.obs_len

    @property
    def repairs(self) -> bool:
        """Whether `forecast` itself repairs tracking errors; by default it takes all positions."""
        return False

    @property
    def unfit(self) -> str:
        """Why it cannot forecast scenes of its own, in words; empty if it can."""
        return ""

    def init(self, key: Array) -> Any:
        """New parameters; consumes `key`. None if they are not known: nothing checks a model's."""
        return None

    @functools.cache  # noqa: B019 (it holds configurations alone)
    def shapes(self) -> Any:
        """The parameters that `init` makes, nested dictionaries of shapes without values."""
        fields = kept_json("shapes", self, self._shape_fields)
        if fields is None:
            return None
        shapes = {}
        for name, (shape, dtype) in fields.items():
            shapes[name] = jax.ShapeDtypeStruct(tuple(shape), dtype)
        return nested_parameters(shapes)

    def _shape_fields(self) -> dict[str, tuple[list[int], str]] | None:
        """Shape and type of each parameter by its path."""
        shapes = jax.eval_shape(lambda: self.init(jax.random.key(0)))
        if shapes is None:
            return None
        refuse_other_tree(shapes)
        leaves = leaves_by_path(shapes)
        return {name: (list(leaf.shape), str(leaf.dtype)) for name, leaf in leaves}

    @abc.abstractmethod
    def forecast(self, params: Any, scene: Scene, noise: Array) -> Array:
        """Futures [k, N, pred_len, 2] of one scene, metres relative to its origin.

        A function for `jax.vmap` and `jax.jit`. The scene has N slots, and neither
        `future` nor `origin`; `noise` is [k, dim], or [k, N, dim] where it is per
        agent; k = 1 for dim 0.
        """

    def checked_futures(self, futures: Array, axes: tuple[Any, ...]) -> Array:
        """What `forecast` returned, [*axes, pred_len, 2]; an axis None has any length.

        Raises:
            InputError: for another shape, which would broadcast.
        """
        expected = (*axes, self.pred_len, 2)
        fits = len(futures.shape) == len(expected)
        if fits:
            pairs = zip(futures.shape, expected)
            fits = all(size is None or length == size for length, size in pairs)
        if not fits:
            raise InputError(
                f"{self.title}: forecast must return [k, N, pred_len, 2], with "
                f"pred_len {self.pred_len}; with all axes of a batch it is "
                f"{[*futures.shape]}"
            )
        return futures

    def prepared(self, scene: Scene) -> Scene:
        """The padded `scene` of a single forecast, with what is best computed on the host."""
        return scene

    @property
    def calibrated(self) -> bool:
        """Whether `distribution` was trained by a proper score, and is not `forecast`'s samples."""
        return False

    def representatives(
        self, params: Any, scene: Scene, noise: Array
    ) -> Representatives:
        """`forecast`, and the probabilities [k] of its samples; None where all have the same."""
        return self.forecast(params, scene, noise), None

    def distribution(
        self,
        params: Any,
        scene: Scene,
        key: Array,
        count: int,
        memory: "Remembered | None" = None,
    ) -> Array:
        """Equally probable draws [n, N, pred_len, 2] of one scene.

        n is `count`, or 1 without noise. By default they are `forecast`'s samples.
        `key` is the run's, the same for every scene: the draws also depend on the
        scene's identity. Of a `memory` of the place, each person takes its share of the
        draws, which are `count` then.
        """
        agents = len(scene.valid)
        noise = scene_noise(
            self.noise, key, jnp.asarray(scene.identity), self.count(count), agents
        )
        draws = self.representatives(params, scene, noise)[0]
        if memory is None:
            return draws
        return memory.among(draws, scene, key, count)

    def points(self, params: Any, scene: Scene, key: Array) -> Array:
        """[P, N, pred_len, 2] equally probable futures of each person by itself.

        By default they are draws.
        """
        return self.distribution(params, scene, key, POINTS)

    def independent_draws(
        self,
        params: Any,
        scene: Scene,
        key: Array,
        count: int,
        memory: "Remembered | None" = None,
    ) -> Array:
        """`distribution`, by draws that are independent of each other, for scores.

        Those of `distribution` may be spread more evenly than chance does.
        """
        return self.distribution(params, scene, key, count, memory)

    def count(self, samples: int) -> int:
        """Number of samples it makes where `samples` are asked for: one without noise.

        Raises:
            InputError: where it cannot make as many.
        """
        return samples if self.noise.dim else 1

    def best_of(self, recipe: Any) -> int:
        """Number of samples of which training and validation take the best."""
        return self.count(getattr(self.config, "samples", 20))

    def init_state(self, recipe: Any, key: Array) -> Any:
        """The `TrainState` before training; consumes `key`."""
        from neurosym_jax.training.state import new_state

        return new_state(recipe, self.init(key))

    def batches(self, windows: Any, recipe: Any) -> Callable[[int], Any]:
        """The batch of each step, a pytree; by default `Groups` of `windows`.

        It depends on nothing but its arguments, the recipe's seed among them.
        """
        from neurosym_jax.training.batches import SceneStream

        return SceneStream(windows, recipe.batch_scenes, recipe.seed).batch

    def groups_of(self, batch: Any) -> tuple[Scene, ...]:
        """The scenes of a batch, a `Scene` [B, N, ...] of each padded size."""
        return batch

    def loss(
        self, params: Any, batch: Any, key: Array, recipe: Any
    ) -> tuple[Array, Any]:
        """[] loss of one batch, and further metrics [] by name; consumes `key`.

        By default the batch is augmented as the recipe says, and the best joint sample
        counts.
        """
        from neurosym_jax.training.state import variety_loss

        return variety_loss(self, params, batch, key, recipe)

    def rounds(
        self, windows: Any, recipe: Any, key: Array
    ) -> Callable[..., tuple[Any, Any]]:
        """`(state, done, count) -> (state, metrics [count])`: `count` steps after `done` ones.

        By default one step of gradient descent by `loss` a batch. The state's buffers
        may be reused. `key` is the run's.
        """
        from neurosym_jax.training.state import gradient_rounds

        return gradient_rounds(self, self.batches(windows, recipe), recipe, key)


def options_of(forecaster: Forecaster, *_: Any) -> Mapping[str, Any]:
    """`compiler_options` of a program whose first static argument is `forecaster`."""
    return forecaster.compiler_options


class TwoStageForecaster(Forecaster):
    """A forecaster that encodes a scene once and decodes it for each noise.

    Where decoding looks at no neighbour, an evaluation decodes the agents of many
    scenes as one scene, without padding and by one program.
    """

    @property
    def encoder(self) -> "TwoStageForecaster | None":
        """The forecaster that encodes: equal ones share a program; None if `encode` gives ()."""
        return None

    @property
    def decodes_alone(self) -> bool:
        """Whether `decode` looks at no neighbour."""
        return True

    def encode(self, params: Any, scene: Scene) -> Any:
        """The context of one scene, which does not depend on the noise: arrays [N, ...] if any."""
        return ()

    @abc.abstractmethod
    def decode(self, params: Any, context: Any, scene: Scene, noise: Array) -> Array:
        """As `forecast`, given the context [N, ...]; if `decodes_alone`, without identity."""

    def forecast(self, params: Any, scene: Scene, noise: Array) -> Array:
        """See `Forecaster.forecast`."""
        return self.decode(params, self.encode(params, scene), scene, noise)


FORECASTERS: Registry[type[Forecaster]] = Registry(
    "forecaster",
    modules={
        "generator": "neurosym_jax.models.sgan.forecaster:GeneratorForecaster",
        "anchors": "neurosym_jax.models.anchors.forecaster:AnchorsForecaster",
        "anchor_table": "neurosym_jax.models.anchors.forecaster:AnchorTableForecaster",
        "constant_velocity": "neurosym_jax.models.baselines:ConstantVelocity",
        "constant_velocity_sampled": "neurosym_jax.models.baselines:ConstantVelocitySampled",
    },
)
"""Families by key. The built-in ones are imported when they are asked for, as plugins are."""

register_forecaster = FORECASTERS.register


def forecaster_of(config: Any) -> Forecaster:
    """The forecaster of a configuration.

    Raises:
        InputError: for the configuration of no family, or of several that learn, and
            one without the fields of `Lengths`.
    """
    # Those imported come first: of the others none may be needed.
    for families in (FORECASTERS.imported(), FORECASTERS.items()):
        for _, family in families:
            if family.Config is type(config):
                _refuse_shared(family)
                _refuse_unsized(config)
                return family(config)
    raise InputError(
        f"config: {type(config).__name__} is the Config of no registered forecaster"
    )


def _refuse_unsized(config: Any) -> None:
    """Refuse a configuration that lacks a field of `Lengths`.

    Raises:
        InputError: naming the field.
    """
    for name in ("obs_len", "pred_len", "period"):
        if not hasattr(config, name):
            raise InputError(
                f"{type(config).__name__} lacks {name}: make it a frozen dataclass that "
                "inherits from neurosym_jax.models.Lengths"
            )


def _refuse_shared(family: type[Forecaster]) -> None:
    """Refuse a configuration by which two families that learn cannot be told apart.

    Raises:
        InputError: naming both.
    """
    if not additions():  # Families that ship have their own.
        return
    names = [
        name
        for name, other in FORECASTERS.items()
        if other.Config is family.Config and other.init is not Forecaster.init
    ]
    if len(names) > 1:
        kind = family.Config.__name__
        raise InputError(
            f"{kind} is the Config of {' and '.join(names)}: give the later one a "
            f"Config of its own, such as a subclass of {kind}"
        )


def refuse_many(
    forecaster: Forecaster, samples: int, agents: int, decoded: int | None = None
) -> None:
    """Refuse a forecast of `agents` people that would not fit into memory: XLA ends the process.

    So is one in a process that was forked after another forecast, which would not end.

    `decoded` is the number of them that are decoded at the same time; default: all.

    Raises:
        InputError: with both sizes.
    """
    refuse_forked()
    # Futures, a copy in their places, offsets from the truth; and the noise.
    future = 6 * forecaster.pred_len + 2 * forecaster.noise.dim
    decoded = agents if decoded is None else decoded
    numbers = agents * future + decoded * forecaster.state_size
    request = f"a forecast of {agents} people at once with {samples} samples"
    refuse_beyond_memory(request, 4.0 * samples * numbers, "ask for fewer samples")


def checked_key(key: Any) -> Array:
    """A random key [], of `jax.random.key` or, [2], of `jax.random.PRNGKey`.

    Raises:
        InputError: for anything else, such as a seed.
    """
    if isinstance(key, Array):
        if jnp.issubdtype(key.dtype, jax.dtypes.prng_key) and key.shape == ():
            return key
        if key.dtype == jnp.uint32 and key.shape == (2,):
            return key
    kind = type(key).__name__
    if isinstance(key, Array):
        kind = f"{key.dtype} {list(key.shape)}"
    raise InputError(f"key must be one, such as jax.random.key(0), not {kind}")


def with_weighting(params: Any, weighting: Weighting | None) -> Any:
    """The parameters of a network, and those that its weighting starts from, if it learns any."""
    start = jax.tree.map(jnp.asarray, initial_parameters(weighting))
    return {**params, "weighting": start} if start else params
