"""Networks by name, with the published sizes."""

from collections.abc import Sequence
from typing import Any

from neurosym_jax.configuration import changed, differences
from neurosym_jax.errors import InputError
from neurosym_jax.models.anchors import AnchorConfig, AnchorTableConfig
from neurosym_jax.models.config import POOLINGS, GeneratorConfig, pooling_names

__all__ = ["ANCHORS", "POOLING_OF", "model_name", "named_network"]

ANCHORS = {"anchors": AnchorConfig, "anchor_table": AnchorTableConfig}
POOLING_OF = {"sgan": "pool_net", "neurosym": "as_described"}
"""The pooling that each model has in its paper."""


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
    if model in ANCHORS:
        if pooling is not None:
            raise InputError(f"--pooling {pooling}: {model} has no pooling")
        config = ANCHORS[model](obs_len=obs_len, pred_len=pred_len)
        weights = [] if weighting is None else [f"weighting={weighting}"]
        return changed(config, [*weights, *changes], "--network", "network")
    symbolic = model == "neurosym"
    name, known = pooling or POOLING_OF[model], pooling_names(symbolic=symbolic)
    if POOLINGS[name] and name not in known:
        raise InputError(f"--pooling {name}: {model} has {', '.join(known)}")
    if weighting is not None and not symbolic:
        raise InputError(f"--weighting {weighting}: {model} weights no pairs; neurosym does")
    weights: Any = weighting  # A configuration reads the text.
    config = GeneratorConfig(
        obs_len=obs_len, pred_len=pred_len, pooling=POOLINGS[name](), weighting=weights
    )
    return changed(config, changes, "--network", "network")


def model_name(config: Any) -> str:
    """A name that tells apart models trained on the same data."""
    for name, kind in ANCHORS.items():
        if isinstance(config, kind):
            lengths = ("obs_len=", "pred_len=", "period=")
            own = [each for each in differences(config) if not each.startswith(lengths)]
            return "_".join([name, *(each.replace("=", "_") for each in own)])
    pooling = POOLINGS.name_of(config.pooling)
    if config.weighting is None:
        return f"sgan_{pooling}"
    return f"neurosym_{pooling.removeprefix('neurosym_')}_{config.weighting.name}"
