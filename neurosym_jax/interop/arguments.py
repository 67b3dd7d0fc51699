"""The arguments of SGAN's code as configurations of ours: of a checkpoint, or of a golden case."""

import dataclasses
from collections.abc import Mapping
from typing import Any

from neurosym_jax.configuration import from_json
from neurosym_jax.errors import InputError
from neurosym_jax.models.config import DiscriminatorConfig, GeneratorConfig
from neurosym_jax.models.poolings import POOLINGS

__all__ = [
    "POOLING_ARGUMENTS",
    "RENAMED_ARGUMENTS",
    "SAME_NAME_ARGUMENTS",
    "TORCH_POOLING",
    "discriminator_config",
    "generator_config",
]

TORCH_POOLING = {"none": "none", "pool_net": "pool_net", "social": "spool"}
"""SGAN's names of the poolings; NeuroSyM's code calls its own `pool_net` as well."""
SAME_NAME_ARGUMENTS = (
    *("obs_len", "pred_len", "embedding_dim", "mlp_dim", "noise_type"),
    *("noise_mix_type", "pool_every_timestep"),
)
POOLING_ARGUMENTS = {"bottleneck_dim": 8, "neighborhood_size": 2.0, "grid_size": 8}
"""Options of poolings, with the values for SGAN where a pooling of ours has no such option."""
RENAMED_ARGUMENTS = {"encoder_h_dim": "encoder_h_dim_g", "decoder_h_dim": "decoder_h_dim_g"}
FIXED = {"batch_norm": False, "num_layers": 1, "activation": "relu"}
"""Arguments of SGAN's networks that ours have in one form only. Dropout acts in training only."""


def generator_config(
    arguments: Mapping[str, Any],
    source: str,
    *,
    variant: str | None = None,
    embedding: tuple[int, ...] | None = None,
) -> GeneratorConfig:
    """The generator of these arguments.

    Args:
        arguments: of SGAN's training.
        source: for messages.
        variant: NeuroSyM's pooling, where it is known.
        embedding: shape of the weights of NeuroSyM's position embedding, which tells its variants
            apart.

    Raises:
        InputError: naming `source` and an argument that is missing or that no network of ours has.
    """
    own = {
        name: _argument(arguments, name, source)
        for name in (*SAME_NAME_ARGUMENTS, "noise_dim", "pooling_type", "bottleneck_dim")
    }
    own |= {ours: _argument(arguments, name, source) for ours, name in RENAMED_ARGUMENTS.items()}
    for name, value in FIXED.items():
        if arguments.get(name, value) != value:
            given = arguments[name]
            raise InputError(f"{source}: {name} is {given!r}, and our networks have {value!r} only")
    if isinstance(noise := own["noise_dim"], tuple | list):
        if len(noise) > 1:
            raise InputError(f"{source}: noise_dim is {noise!r}, and ours is one number")
        noise = noise[0] if noise else 0
    own["noise_dim"] = 0 if noise is None else noise
    own["pool_every_timestep"] = bool(own["pool_every_timestep"])
    torch_pooling = str(own.pop("pooling_type") or "none").lower()
    named = {theirs: ours for ours, theirs in TORCH_POOLING.items()}
    if embedding is not None and torch_pooling == "pool_net":
        variant = "neurosym_ijcnn" if embedding[1:] == (2,) else "neurosym_ros"
        if variant == "neurosym_ros":
            own["weighting"] = arguments.get("weighting", "cnd_shipped")
    if variant is not None:
        named = {"pool_net": variant}
    if torch_pooling not in named:
        known = ", ".join(map(repr, named))
        raise InputError(f"{source}: pooling_type is one of {known}, not {torch_pooling!r}")
    kind, pooled = named[torch_pooling], own.pop("bottleneck_dim")
    options = {"bottleneck_dim": pooled}
    if kind == "social":
        options |= {name: _argument(arguments, name, source) for name in POOLING_ARGUMENTS}
        if pooled != own["encoder_h_dim"]:
            raise InputError(
                f"{source}: social pooling returns a hidden state: bottleneck_dim must equal "
                f"encoder_h_dim ({own['encoder_h_dim']}), not {pooled}"
            )
    fields = {field.name for field in dataclasses.fields(POOLINGS[kind])}
    own["pooling"] = {"kind": kind} | {k: v for k, v in options.items() if k in fields}
    return from_json(GeneratorConfig, own, source)


def discriminator_config(arguments: Mapping[str, Any], source: str) -> DiscriminatorConfig:
    """The discriminator of these arguments.

    Raises:
        InputError: as `generator_config`.
    """
    theirs = {"kind": "d_type", "h_dim": "encoder_h_dim_d"}
    theirs |= {name: name for name in ("embedding_dim", "mlp_dim")}
    fields = {ours: _argument(arguments, name, source) for ours, name in theirs.items()}
    return from_json(DiscriminatorConfig, fields, source)


def _argument(arguments: Mapping[str, Any], name: str, source: str) -> Any:
    if name not in arguments:
        raise InputError(f"{source}: {name} is missing or not a plain value")
    return arguments[name]
