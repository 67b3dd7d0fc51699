"""The generator that a model asked for by name stands for, with the published sizes."""

import dataclasses
from collections.abc import Sequence

from neurosym_jax.config import GeneratorConfig
from neurosym_jax.configuration import changed
from neurosym_jax.errors import InputError
from neurosym_jax.models.poolings import POOLINGS, pooling_names
from neurosym_jax.plugins import load_plugin
from neurosym_jax.symbolic.weighting_config import WeightingConfig

__all__ = ["model_name", "named_generator", "named_weighting"]


def named_generator(
    model: str = "sgan",
    *,
    pooling: str = "pool_net",
    variant: str = "as_described",
    weighting: str = "cnd",
    obs_len: int = 8,
    pred_len: int = 8,
    changes: Sequence[str] = (),
) -> GeneratorConfig:
    """The generator of `sgan` or `neurosym`.

    Args:
        model: one of the two.
        pooling: of SGAN, a registered one.
        variant: of NeuroSyM, a registered pooling that takes weights.
        weighting: of NeuroSyM, see `named_weighting`.
        obs_len: observed steps.
        pred_len: steps to forecast.
        changes: of the published sizes, each NAME=VALUE of a field of `GeneratorConfig`.

    Raises:
        InputError: for an unknown pooling or weighting, or a change that does not fit.
    """
    symbolic = model == "neurosym"
    name = variant if symbolic else pooling
    known = pooling_names(symbolic=symbolic)
    if name not in known:
        option = "variant" if symbolic else "pooling"
        raise InputError(f"--{option} {name}: {model} has {', '.join(known)}")
    config = GeneratorConfig(obs_len=obs_len, pred_len=pred_len)
    if POOLINGS[name].returns_hidden:
        config = dataclasses.replace(config, bottleneck_dim=config.encoder_h_dim)
    weights = named_weighting(weighting) if symbolic else None
    config = dataclasses.replace(config, pooling=name, weighting=weights)
    return changed(config, changes, "--network", "network")


def named_weighting(text: str) -> WeightingConfig:
    """The weighting KIND[,FIELD=VALUE...]; `MODULE:KIND` imports the module that registers it.

    Raises:
        InputError: for a module that cannot be imported, or whatever else is not a weighting.
    """
    module, _, name = text.rpartition(":")
    if module:
        load_plugin(module)
    return WeightingConfig.from_text(name, f"weighting {text}")


def model_name(config: GeneratorConfig) -> str:
    """What tells models apart that are trained on the same data."""
    if config.weighting is None:
        return f"sgan_{config.pooling}"
    return f"neurosym_{config.pooling.removeprefix('neurosym_')}_{config.weighting.name}"
