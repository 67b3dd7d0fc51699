"""SGAN's arguments and weights as configurations of ours.

Widths are read from the shapes of the weights, everything else from the arguments.
"""

import dataclasses
import re
from collections.abc import Iterable, Mapping
from typing import Any

from neurosym_jax.configuration import from_json
from neurosym_jax.errors import InputError
from neurosym_jax.models.config import DiscriminatorConfig, GeneratorConfig
from neurosym_jax.models.poolings import POOLINGS

__all__ = ["TORCH_POOLING", "assumptions", "discriminator_config", "generator_config"]
__all__ += ["unknown"]

TORCH_POOLING = {"none": "none", "pool_net": "pool_net", "social": "spool"}
"""SGAN's names of the poolings; NeuroSyM's code calls its own `pool_net` as well."""
NEEDED = {
    *("obs_len", "pred_len", "noise_dim", "noise_type", "noise_mix_type", "pooling_type"),
    "pool_every_timestep",
}
"""What weights cannot say, or must not contradict."""
FIXED = {"num_layers": 1, "activation": "relu", "batch_norm": False}
"""Arguments of SGAN's networks that ours have in one form only."""
WIDTHS = {
    "embedding_dim": (r"encoder.spatial_embedding.weight", 0),
    "encoder_h_dim": (r"encoder.encoder.weight_hh_l0", 1),
    "decoder_h_dim": (r"decoder.decoder.weight_hh_l0", 1),
    "mlp_dim": (r"(mlp_decoder_context|decoder.mlp|real_classifier).0.weight", 0),
    "hidden_dim": (r"pool_net(_g)?.mlp_pre_pool.0.weight", 0),
    "bottleneck_dim": (r"pool_net(_g)?.mlp_pre_pool.2.weight", 0),
}
"""Our fields, the weights that have the width, and on which axis."""
PASSED = (
    "dropout neighborhood_size grid_size weighting d_type h_dim encoder_h_dim_d encoder_h_dim_g "
    "decoder_h_dim_g "
    "dataset_name delim loader_num_workers skip batch_size num_iterations num_epochs best_k "
    "clipping_threshold_g clipping_threshold_d g_learning_rate d_learning_rate g_steps d_steps "
    "l2_loss_weight output_dir print_every checkpoint_every checkpoint_name checkpoint_start_from "
    "restore_from_checkpoint num_samples_check use_gpu timing gpu_num labels_dir filename"
)
"""Further arguments of the released code, most of its training."""


def generator_config(arguments: Mapping[str, Any], state: Mapping[str, Any]) -> GeneratorConfig:
    """The generator of these arguments and weights.

    Args:
        arguments: of SGAN's training or of its generator.
        state: arrays by torch's names; they say which of NeuroSyM's networks it is.

    Raises:
        InputError: naming an argument that is missing or that our networks lack.
    """
    given = _needed(arguments, NEEDED)
    noise = given["noise_dim"] or 0
    given["noise_dim"] = noise[0] if isinstance(noise, tuple | list) and len(noise) == 1 else noise
    given["pool_every_timestep"] = bool(given["pool_every_timestep"])
    torch_pooling = str(given.pop("pooling_type") or "none").lower()
    kinds = {theirs: ours for ours, theirs in TORCH_POOLING.items()}
    history = state.get("pool_net_g.spatial_embedding.weight")
    if history is not None and history.shape[-1] == 2:
        kinds = {"pool_net": "neurosym_ijcnn"}
    elif history is not None:
        kinds = {"pool_net": "neurosym_ros"}
        given["weighting"] = arguments.get("weighting", "cnd_shipped")
    if torch_pooling not in kinds:
        known = ", ".join(map(repr, kinds))
        raise InputError(f"args: pooling_type is one of {known}, not {torch_pooling!r}")
    kind = kinds[torch_pooling]
    known = given | _widths(arguments, state)
    if kind == "social":
        known |= _needed(arguments, ("neighborhood_size", "grid_size"))
    pooling = {"kind": kind, **_of_fields(POOLINGS[kind], known)}
    fields = _of_fields(GeneratorConfig, known) | {"pooling": pooling}
    return from_json(GeneratorConfig, fields, "args")


def discriminator_config(
    arguments: Mapping[str, Any], state: Mapping[str, Any]
) -> DiscriminatorConfig:
    """The discriminator of these arguments and weights; raises as `generator_config`."""
    names = {"encoder_h_dim": "h_dim", "hidden_dim": "pool_hidden_dim"}
    widths = {names.get(name, name): width for name, width in _widths({}, state).items()}
    fields = {"kind": _needed(arguments, ["d_type"])["d_type"], **widths}
    return from_json(DiscriminatorConfig, _of_fields(DiscriminatorConfig, fields), "args")


def assumptions(arguments: Mapping[str, Any], config: GeneratorConfig) -> tuple[str, ...]:
    """What arguments and weights do not say, in words."""
    found = ["forward as in the released code"]
    if "activation" not in arguments:
        found.append("activation relu")
    if config.weighting is not None and "weighting" not in arguments:
        found.append(f"pairs weighted by {config.weighting.name}")
    found += [f"the unknown argument {name} changes nothing" for name in unknown(arguments)]
    return tuple(found)


def unknown(arguments: Mapping[str, Any]) -> list[str]:
    """Names of the arguments that the released code does not have."""
    return sorted(set(arguments) - {*NEEDED, *FIXED, *WIDTHS, *PASSED.split()})


def _needed(arguments: Mapping[str, Any], names: Iterable[str]) -> dict[str, Any]:
    for name, value in FIXED.items():
        if arguments.get(name, value) != value:
            raise InputError(
                f"args: {name} is {arguments[name]!r}, and our networks have {value!r} only"
            )
    if missing := set(names) - set(arguments):
        raise InputError(f"args: {min(missing)} is missing")
    return {name: arguments[name] for name in names}


def _widths(arguments: Mapping[str, Any], state: Mapping[str, Any]) -> dict[str, Any]:
    """Our fields that are widths, by the weights, else by the arguments."""
    found = {}
    for field, (pattern, axis) in WIDTHS.items():
        weights = [array for name, array in state.items() if re.fullmatch(pattern, name)]
        if weights and weights[0].ndim == 2:
            found[field] = weights[0].shape[axis]
        elif (width := arguments.get(field, arguments.get(f"{field}_g"))) is not None:
            found[field] = width
    return found


def _of_fields(config: type, values: Mapping[str, Any]) -> dict[str, Any]:
    """Those of `values` that are fields of `config`."""
    names = {field.name for field in dataclasses.fields(config)}
    return {name: value for name, value in values.items() if name in names}
