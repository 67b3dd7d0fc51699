"""Networks by name, with the published sizes."""

import dataclasses
from collections.abc import Sequence
from typing import Any

from neurosym_jax.configuration import changed, differences
from neurosym_jax.errors import InputError
from neurosym_jax.models.anchors import AnchorConfig, AnchorTableConfig
from neurosym_jax.models.config import POOLINGS, GeneratorConfig, pooling_names

__all__ = ["NETWORKS", "model_name", "named_network"]

NETWORKS: dict[str, Any] = {
    "sgan": GeneratorConfig(),
    "neurosym": GeneratorConfig(pooling=POOLINGS["as_described"]()),
    "anchors": AnchorConfig(),
    "anchor_table": AnchorTableConfig(),
}
"""Configurations, with the poolings of the papers."""


def named_network(
    model: str = "sgan",
    *,
    pooling: str | None = None,
    weighting: str | None = None,
    obs_len: int = 8,
    pred_len: int = 8,
    changes: Sequence[str] = (),
) -> Any:
    """The configuration of `sgan`, `neurosym`, `anchors` or `anchor_table`.

    Args:
        model: which.
        pooling: of a generator; default: the paper's. That of NeuroSyM takes weights.
        weighting: of NeuroSyM (default: `cnd`) or anchors (default: none), as
            KIND[,FIELD=VALUE...].
        obs_len: observed steps.
        pred_len: steps to forecast.
        changes: of the published sizes, each NAME=VALUE of a field of the configuration.

    Raises:
        InputError: for an unknown pooling or weighting, one that the model cannot have, or a change
            that does not fit.
    """
    config = dataclasses.replace(NETWORKS[model], obs_len=obs_len, pred_len=pred_len)
    symbolic = model == "neurosym"
    if pooling is not None:
        known = pooling_names(symbolic=symbolic) if isinstance(config, GeneratorConfig) else ()
        if POOLINGS[pooling] and pooling not in known:
            raise InputError(f"--pooling {pooling}: {model} has {', '.join(known) or 'no pooling'}")
    if weighting is not None and model == "sgan":
        raise InputError(f"--weighting {weighting}: {model} weights no pairs; neurosym does")
    asked = {"pooling": pooling, "weighting": weighting}
    own = [f"{name}={value}" for name, value in asked.items() if value is not None]
    return changed(config, [*own, *changes], "--network", "network")


def model_name(config: Any) -> str:
    """A name that tells apart models trained on the same data."""
    if isinstance(config, GeneratorConfig):
        pooling = POOLINGS.name_of(config.pooling)
        if config.weighting is None:
            return f"sgan_{pooling}"
        return f"neurosym_{pooling.removeprefix('neurosym_')}_{config.weighting.name}"
    lengths = ("obs_len=", "pred_len=", "period=")
    own = [each for each in differences(config) if not each.startswith(lengths)]
    name = "anchors" if isinstance(config, AnchorConfig) else "anchor_table"
    return "_".join([name, *(each.replace("=", "_") for each in own)])
