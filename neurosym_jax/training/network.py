"""Generators by name, with the published sizes."""

from collections.abc import Sequence

from neurosym_jax.configuration import changed, component_from_text
from neurosym_jax.errors import InputError
from neurosym_jax.models.config import GeneratorConfig
from neurosym_jax.models.poolings import POOLINGS, pooling_names
from neurosym_jax.plugins import load_plugin
from neurosym_jax.symbolic.weighting import Weighting
from neurosym_jax.symbolic.weightings import WEIGHTINGS

__all__ = ["POOLING_OF", "model_name", "named_generator", "named_weighting"]


POOLING_OF = {"sgan": "pool_net", "neurosym": "as_described"}
"""The pooling that each model has in its paper."""


def named_generator(
    model: str = "sgan",
    *,
    pooling: str | None = None,
    weighting: str | None = None,
    obs_len: int = 8,
    pred_len: int = 8,
    changes: Sequence[str] = (),
) -> GeneratorConfig:
    """The generator of `sgan` or `neurosym`.

    Args:
        model: one of the two.
        pooling: a registered one, that takes weights for NeuroSyM; default: the paper's.
        weighting: of NeuroSyM, see `named_weighting`; default: `cnd`.
        obs_len: observed steps.
        pred_len: steps to forecast.
        changes: of the published sizes, each NAME=VALUE of a field of `GeneratorConfig`.

    Raises:
        InputError: for an unknown pooling or weighting, one that the model cannot have, or a change
            that does not fit.
    """
    symbolic = model == "neurosym"
    name = pooling or POOLING_OF[model]
    known = pooling_names(symbolic=symbolic)
    if POOLINGS[name] and name not in known:
        raise InputError(f"--pooling {name}: {model} has {', '.join(known)}")
    if weighting is not None and not symbolic:
        raise InputError(f"--weighting {weighting}: {model} weights no pairs; neurosym does")
    weights = named_weighting(weighting or "cnd") if symbolic else None
    config = GeneratorConfig(
        obs_len=obs_len, pred_len=pred_len, pooling=POOLINGS[name](), weighting=weights
    )
    return changed(config, changes, "--network", "network")


def named_weighting(text: str) -> Weighting:
    """The weighting KIND[,FIELD=VALUE...]; `MODULE:KIND` imports the module that registers it.

    Raises:
        InputError: for a module that cannot be imported, or whatever else is not a weighting.
    """
    module, _, name = text.rpartition(":")
    if module:
        load_plugin(module)
    return component_from_text(name, WEIGHTINGS, f"weighting {text}")


def model_name(config: GeneratorConfig) -> str:
    """A name that tells apart models trained on the same data."""
    pooling = POOLINGS.name_of(config.pooling)
    if config.weighting is None:
        return f"sgan_{pooling}"
    return f"neurosym_{pooling.removeprefix('neurosym_')}_{config.weighting.name}"
