"""Torch checkpoints of SGAN and NeuroSyM, read and written without torch.

`interop.pickles` reads a `.pt` file, `interop.names` maps its tensors, `interop.arguments` its
arguments.
"""

import dataclasses
import math
import os
from collections import OrderedDict
from collections.abc import Mapping
from typing import Any

from neurosym_jax.errors import InputError
from neurosym_jax.interop.arguments import (
    POOLING_ARGUMENTS,
    RENAMED_ARGUMENTS,
    SAME_NAME_ARGUMENTS,
    TORCH_POOLING,
    discriminator_config,
    generator_config,
)
from neurosym_jax.interop.names import params_from_torch, params_to_torch
from neurosym_jax.interop.pickle_writer import write_torch_file
from neurosym_jax.interop.pickles import read_torch_file
from neurosym_jax.models.config import DiscriminatorConfig, GeneratorConfig
from neurosym_jax.models.poolings import POOLINGS
from neurosym_jax.models.social import Social
from neurosym_jax.symbolic.weighting import initial_parameters

__all__ = ["TorchCheckpoint", "export_torch_checkpoint", "load_torch_checkpoint"]

# SGAN's evaluation script reads these as well: what its networks were built and data cut with.
EXPORTED_ARGUMENTS = {
    "num_layers": 1,
    "dropout": 0.0,
    "batch_norm": False,
    "delim": "tab",
    "skip": 1,
    "batch_size": 64,
    "loader_num_workers": 4,
}


@dataclasses.dataclass(frozen=True)
class TorchCheckpoint:
    """What a torch checkpoint holds, in our terms."""

    config: GeneratorConfig
    params: dict[str, Any]
    """The generator's parameters: nested dictionaries of float32 arrays."""
    discriminator: tuple[DiscriminatorConfig, dict[str, Any]] | None
    """The discriminator's configuration and parameters, where the file has them."""
    scene: str | None
    """The dataset it was trained to be tested on (`eth`, `zara1`, ...), where the file says."""
    arguments: dict[str, Any]
    """Every argument of the training that is a number, a string, None or a tuple of them."""


def load_torch_checkpoint(path: str | os.PathLike) -> TorchCheckpoint:
    """The checkpoint that SGAN, NeuroSyM or `export_torch_checkpoint` wrote to `path`.

    Published files hold `g_state` and `args`; those of a training run hold more. The generator
    is always `g_state`, which SGAN's own evaluation uses, never `g_best_state`. NeuroSyM's files do
    not say which of its networks they are, nor how alpha was weighted: the network is inferred from
    its tensors, and the weighting is the authors' table unless the file was exported from here.

    Raises:
        InputError: naming `path` and what is missing or wrong: an unreadable, damaged or foreign
            file, an argument, a tensor.
    """
    contents = read_torch_file(path)
    try:
        if not isinstance(contents, dict):
            raise InputError("holds no dictionary: not a checkpoint of SGAN")
        state, given = (contents.get(key) for key in ("g_state", "args"))
        if not isinstance(state, dict) or not isinstance(given, dict):
            missing = "g_state" if not isinstance(state, dict) else "args"
            raise InputError(f"has no {missing}: not a checkpoint of SGAN, or one without weights")
        _refuse_repeated(state, os.path.getsize(path))
        arguments = {k: v for k, v in given.items() if isinstance(k, str) and _is_plain(v)}
        embedding = getattr(state.get("pool_net_g.spatial_embedding.weight"), "shape", None)
        shape = embedding if isinstance(embedding, tuple) else None
        config = generator_config(arguments, "args", embedding=shape)
        discriminator = None
        if (d_state := contents.get("d_state")) is not None:
            if not isinstance(d_state, dict):
                raise InputError("d_state is not a state dict")
            _refuse_repeated(d_state, os.path.getsize(path))
            d_config = discriminator_config(arguments, "args")
            discriminator = d_config, params_from_torch(d_state, d_config)
        scene = arguments.get("dataset_name")
        return TorchCheckpoint(
            config=config,
            params=params_from_torch(state, config),
            discriminator=discriminator,
            scene=scene if isinstance(scene, str) else None,
            arguments=arguments,
        )
    except InputError as error:
        raise InputError(f"{path}: {error}") from None


def export_torch_checkpoint(
    path: str | os.PathLike,
    config: GeneratorConfig,
    params: Mapping[str, Any],
    *,
    scene: str | None = None,
    discriminator: tuple[DiscriminatorConfig, Mapping[str, Any]] | None = None,
    overwrite: bool = False,
) -> None:
    """Write a `.pt` that `torch.load(path, weights_only=True)` opens and the torch code can build.

    That is SGAN's, or for `neurosym_ros` and `neurosym_ijcnn` the release that each is named after.
    Their generators declare a second pooling, `pool_net_d`, that they never call; it is written as
    zeros, because `load_state_dict` insists on it.

    Raises:
        InputError: when `path` exists and `overwrite` is False, or cannot be written; when a
            parameter is missing, unexpected or misshapen; when SGAN's arguments cannot express
            the configuration; for `as_described` and learned weightings, which torch does not have.
    """
    if config.noise_type == "fixed":
        # Nor is there any sample beside constant velocity, which has fixed noise.
        raise InputError("noise_type fixed has no counterpart in torch, which draws noise anew")
    arguments: dict[str, Any] = {
        **EXPORTED_ARGUMENTS,
        **{name: getattr(config, name) for name in SAME_NAME_ARGUMENTS},
        **{theirs: getattr(config, ours) for ours, theirs in RENAMED_ARGUMENTS.items()},
        **{k: getattr(config.pooling, k, usual) for k, usual in POOLING_ARGUMENTS.items()},
        "noise_dim": (config.noise_dim,),
        "pooling_type": TORCH_POOLING.get(POOLINGS.name_of(config.pooling), "pool_net"),
        "dataset_name": scene,
    }
    if config.weighting is not None:
        # No argument of the released code's, whose weighting is the data's; it passes over it.
        if initial_parameters(config.weighting):
            raise InputError(f"the weights {config.weighting.name} are learned: no torch has them")
        arguments["weighting"] = config.weighting.name
    if isinstance(config.pooling, Social):
        arguments["bottleneck_dim"] = config.encoder_h_dim
    contents: dict[str, Any] = {
        "g_state": OrderedDict(params_to_torch(params, config)),
        "args": arguments,
    }
    pool_hidden_dims = {getattr(config.pooling, "hidden_dim", 512)}
    if discriminator is not None:
        d_config, d_params = discriminator
        contents["d_state"] = OrderedDict(params_to_torch(d_params, d_config))
        arguments |= {"d_type": d_config.kind, "encoder_h_dim_d": d_config.h_dim}
        if (d_config.embedding_dim, d_config.mlp_dim) != (config.embedding_dim, config.mlp_dim):
            raise InputError(
                "SGAN has one embedding_dim and one mlp_dim for generator and discriminator, "
                f"but they are {config.embedding_dim}, {config.mlp_dim} "
                f"and {d_config.embedding_dim}, {d_config.mlp_dim}"
            )
        if d_config.kind == "global":
            pool_hidden_dims.add(d_config.pool_hidden_dim)
    if pool_hidden_dims - {512}:
        raise InputError(f"SGAN's pool_hidden_dim is fixed at 512, not {max(pool_hidden_dims)}")
    write_torch_file(path, contents, overwrite=overwrite)


def _refuse_repeated(state: Mapping[str, Any], size: int) -> None:
    """Tensors that lie over each other may ask for any multiple of the file's `size`, bytes."""
    shapes = [getattr(tensor, "shape", None) for tensor in state.values()]
    if 2 * sum(math.prod(shape) for shape in shapes if isinstance(shape, tuple)) > size:
        raise InputError("its tensors have more elements than the file can hold")


def _is_plain(value: Any) -> bool:
    if isinstance(value, tuple | list):
        return all(not isinstance(part, tuple | list) and _is_plain(part) for part in value)
    # Python refuses to print integers of thousands of digits, which a damaged file may hold.
    is_number = isinstance(value, float) or (isinstance(value, int) and abs(value) < 2**63)
    return value is None or is_number or isinstance(value, str)
