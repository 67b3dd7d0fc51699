"""The table of forecasters, with the built-in ones; a plugin adds to it."""

import dataclasses
import functools
from collections.abc import Callable, Mapping
from typing import Any

import jax
import numpy as np

from neurosym_jax.config import GeneratorConfig
from neurosym_jax.errors import InputError
from neurosym_jax.forecasting.baselines import ConstantVelocity, ConstantVelocitySampled
from neurosym_jax.forecasting.forecaster import Forecaster
from neurosym_jax.forecasting.kinds import ForecasterKind, Lengths, Shapes
from neurosym_jax.forecasting.networks import GeneratorForecaster
from neurosym_jax.models.poolings import POOLINGS
from neurosym_jax.registry import Registry
from neurosym_jax.scene import make_scene

__all__ = ["FORECASTERS", "register_forecaster"]


def _generator_title(config: GeneratorConfig) -> str:
    pooling, weighting = POOLINGS[config.pooling], config.weighting
    title = pooling.label
    if weighting is not None and pooling.of_pairs:
        title += f", {weighting.name}"
    return f"{title}, beside constant velocity" if config.beside_velocity else title


def _generator_shapes(config: GeneratorConfig) -> Mapping[str, tuple[int, ...]]:
    from neurosym_jax.symbolic.weighting import initial_parameters

    params: Any = _fresh.eval_shape(config, jax.random.key(0))
    if parameters := initial_parameters(config.weighting):
        params = {**params, "weighting": parameters}
    leaves = jax.tree_util.tree_leaves_with_path(params)
    return {jax.tree_util.keystr(at, simple=True, separator="/"): leaf.shape for at, leaf in leaves}


@functools.partial(jax.jit, static_argnums=0)
def _fresh(config: GeneratorConfig, key: jax.Array) -> Any:
    """New parameters; compiled only so that its shapes are traced once a configuration."""
    from neurosym_jax.models import Generator

    scene = make_scene(np.zeros((1, config.obs_len, 2)))
    pairs = (1, 1) if POOLINGS[config.pooling].of_pairs else (1,)
    alpha = np.zeros((*pairs, config.obs_len))
    weigh = (lambda *_: alpha) if config.symbolic else None
    return Generator(config).init(key, scene, np.zeros((1, config.noise_dim)), alpha, weigh)


FORECASTERS: Registry[ForecasterKind] = Registry(
    "forecaster",
    {
        "generator": ForecasterKind(
            GeneratorForecaster, GeneratorConfig, _generator_title, _generator_shapes
        ),
        "constant_velocity": ForecasterKind(
            lambda config: ConstantVelocity(config.pred_len), Lengths, "constant velocity", None
        ),
        "constant_velocity_sampled": ForecasterKind(
            lambda config: ConstantVelocitySampled(config.pred_len),
            Lengths,
            "constant velocity, sampled",
            None,
        ),
    },
)


def register_forecaster(
    name: str,
    make: Callable[[Any], Forecaster],
    *,
    config: type = Lengths,
    title: Callable[[Any], str] | str | None = None,
    shapes: Shapes | None = None,
    replace: bool = False,
) -> None:
    """Add a kind of forecasters.

    Args:
        name: how a model folder and `--baselines` name it.
        make: from a configuration to the forecaster; equal configurations give equal forecasters,
            so that they share compiled programs.
        config: the configuration's type, a frozen dataclass that has at least `obs_len`, `pred_len`
            and `period` as `Lengths` has them, and values that JSON can hold.
        title: what tables call it, or a function of the configuration; the name by default.
        shapes: from a configuration to the shapes of the parameters by path (see `parameters`), by
            which a model's folder is checked; by default it is not.
        replace: put it in the place of another of this name.

    Raises:
        InputError: for what is no name, one that is taken, or a configuration without these fields.
    """
    wanted = {field.name for field in dataclasses.fields(Lengths)}
    has = {field.name for field in dataclasses.fields(config)} if _is_frozen(config) else set()
    if missing := wanted - has:
        raise InputError(
            f"forecaster {name!r}: its configuration must be a frozen dataclass with the fields "
            f"{', '.join(sorted(missing))}"
        )
    kind = ForecasterKind(make, config, name if title is None else title, shapes)
    FORECASTERS.register(name, kind, replace=replace)


def _is_frozen(config: Any) -> bool:
    parameters = getattr(config, "__dataclass_params__", None)
    return isinstance(config, type) and parameters is not None and parameters.frozen
