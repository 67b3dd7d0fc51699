"""Torch checkpoints of SGAN and NeuroSyM: read without torch, written with it."""

import os
from collections import OrderedDict
from collections.abc import Collection
from pathlib import Path
from typing import Any

import numpy as np

from neurosym_jax.errors import InputError
from neurosym_jax.forecasting.model import Model
from neurosym_jax.interop.arguments import TORCH_POOLING, assumptions, generator_config, unknown
from neurosym_jax.interop.names import params_from_torch, params_to_torch, without_dropout
from neurosym_jax.interop.pickles import StoredTensor, read_torch_file
from neurosym_jax.models.config import GeneratorConfig
from neurosym_jax.models.poolings import POOLINGS
from neurosym_jax.models.social import Social
from neurosym_jax.runtime.files import new_file
from neurosym_jax.symbolic.weighting import initial_parameters

__all__ = [
    "export_torch_checkpoint",
    "load_torch_checkpoint",
    "model_from_torch",
    "torch_contents",
]

EXPORTED = {
    "num_layers": 1,
    "activation": "relu",
    "dropout": 0.0,
    "batch_norm": False,
    # SGAN's evaluation script reads these as well.
    "delim": "tab",
    "skip": 1,
    "batch_size": 64,
    "loader_num_workers": 4,
}
SAME = ("obs_len", "pred_len", "embedding_dim", "mlp_dim", "noise_type", "noise_mix_type")
OPTIONS = {"bottleneck_dim": 8, "neighborhood_size": 2.0, "grid_size": 8}
"""Of poolings; SGAN's constructor takes all of them, whichever pooling it builds."""


def load_torch_checkpoint(path: str | os.PathLike, ignored: Collection[str] | None = ()) -> Model:
    """The generator that SGAN, NeuroSyM or `export_torch_checkpoint` wrote to `path`.

    Args:
        path: the file.
        ignored: names of unknown arguments that do not change the network; None for all.

    Raises:
        InputError: naming `path` and what is missing or wrong: an unreadable, damaged or foreign
            file, an argument, a tensor.
    """
    contents = read_torch_file(path)
    try:
        return model_from_torch(contents, ignored)
    except InputError as error:
        raise InputError(f"{path}: {error}") from None


def model_from_torch(contents: Any, ignored: Collection[str] | None = ()) -> Model:
    """The generator in the dictionary that SGAN's training saves.

    It is `g_state`, which SGAN's own evaluation uses, never `g_best_state`. NeuroSyM's files do not
    say which of its networks they are, nor how alpha was weighted: the network is inferred from its
    tensors, and the weighting is the authors' table unless the file was exported from here.

    Raises:
        InputError: naming what is missing or wrong.
    """
    if not isinstance(contents, dict):
        raise InputError("holds no dictionary: not a checkpoint of SGAN")
    for name in ("g_state", "args"):
        if not isinstance(contents.get(name), dict):
            raise InputError(f"has no {name}: not a checkpoint of SGAN, or one without weights")
    arguments = {str(name): value for name, value in contents["args"].items()}
    names = unknown(arguments)
    if refused := [name for name in names if ignored is not None and name not in ignored]:
        raise InputError(
            f"unknown argument {refused[0]!r}, which may change the network: if it does not, "
            f"`neurosym convert --ignore-arg {refused[0]}`"
        )
    state = {}
    for name, tensor in contents["g_state"].items():
        if not isinstance(name, str) or not isinstance(tensor, np.ndarray | StoredTensor):
            raise InputError(f"g_state is not a state dict: {name!r:.80} is no tensor")
        state[name] = np.asarray(tensor)
    state = without_dropout(state, arguments)
    config = generator_config(arguments, state)
    scene = arguments.get("dataset_name")
    dataset = scene if isinstance(scene, str) else None
    params = {"params": params_from_torch(state, config)}
    return Model(config, params, dataset, assumed=assumptions(arguments, config))


def export_torch_checkpoint(path: Path | str, model: Model) -> None:
    """Write `torch_contents` with torch, which must be installed, as a `.pt` of weights only.

    Raises:
        InputError: when `path` cannot be written, torch is absent, or as `torch_contents`.
    """
    contents = torch_contents(model)
    try:
        import torch  # pyright: ignore[reportMissingImports]
    except ImportError:
        raise InputError(f"{path}: torch writes it, and is not installed here") from None
    if os.path.exists(path):
        raise InputError(f"{path}: exists already")
    tensors = ((name, torch.from_numpy(array)) for name, array in contents["g_state"].items())
    contents["g_state"] = OrderedDict(tensors)
    with new_file(path) as beside:
        torch.save(contents, beside)


def torch_contents(model: Model) -> dict[str, Any]:
    """`args` and `g_state` as SGAN's code saves them, with arrays for tensors.

    The code is SGAN's, or for `neurosym_ros` and `neurosym_ijcnn` the release that each is named
    after.

    Raises:
        InputError: for a network that SGAN's arguments cannot express, `as_described` and learned
            weightings, which torch does not have.
    """
    config = model.config
    if not isinstance(config, GeneratorConfig):
        raise InputError(f"{model.name} has no counterpart in torch")
    arguments: dict[str, Any] = {
        **EXPORTED,
        **{name: getattr(config, name) for name in SAME},
        **{f"{name}_g": getattr(config, name) for name in ("encoder_h_dim", "decoder_h_dim")},
        **{name: getattr(config.pooling, name, usual) for name, usual in OPTIONS.items()},
        "pool_every_timestep": config.pool_every_timestep,
        "noise_dim": (config.noise_dim,),
        "pooling_type": TORCH_POOLING.get(POOLINGS.name_of(config.pooling), "pool_net"),
        "dataset_name": model.dataset,
    }
    if config.weighting is not None:
        # No argument of the released code's, whose weighting is the data's; it passes over it.
        if initial_parameters(config.weighting):
            raise InputError(f"the weights {config.weighting.name} are learned: no torch has them")
        arguments["weighting"] = config.weighting.name
    if isinstance(config.pooling, Social):
        arguments["bottleneck_dim"] = config.encoder_h_dim
    if (width := getattr(config.pooling, "hidden_dim", 512)) != 512:
        raise InputError(f"SGAN's pool_hidden_dim is fixed at 512, not {width}")
    return {"g_state": params_to_torch(model.params["params"], config), "args": arguments}
