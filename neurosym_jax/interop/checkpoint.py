"""Torch checkpoints of SGAN and NeuroSyM: read without torch, written with it.

`interop.pickles` reads a `.pt` file, `interop.names` maps its tensors, `interop.arguments` its
arguments.
"""

import math
import os
from collections import OrderedDict
from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Any

from neurosym_jax.errors import InputError
from neurosym_jax.forecasting.model import Model
from neurosym_jax.interop.arguments import (
    TORCH_POOLING,
    assumptions,
    generator_config,
    refuse_unknown,
)
from neurosym_jax.interop.names import params_from_torch, params_to_torch, plain_state
from neurosym_jax.interop.pickles import read_torch_file
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
UNUSED = {"bottleneck_dim": 8, "neighborhood_size": 2.0, "grid_size": 8}
"""Options of poolings that SGAN's constructor is given even where the pooling has none."""


def load_torch_checkpoint(path: str | os.PathLike, ignore: Collection[str] = ()) -> Model:
    """The generator that SGAN, NeuroSyM or `export_torch_checkpoint` wrote to `path`.

    Args:
        path: of the file.
        ignore: arguments that nobody knows and that do not change the network.

    Raises:
        InputError: naming `path` and what is missing or wrong: an unreadable, damaged or foreign
            file, an argument, a tensor.
    """
    contents = read_torch_file(path)
    try:
        return model_from_torch(contents, ignore, size=os.path.getsize(path))
    except InputError as error:
        raise InputError(f"{path}: {error}") from None


def model_from_torch(
    contents: Any, ignore: Collection[str] = (), *, size: float = math.inf
) -> Model:
    """The generator in the dictionary that SGAN's training saves.

    Published files hold `g_state` and `args`; those of a training run hold more, which is passed
    over. The generator is always `g_state`, which SGAN's own evaluation uses, never `g_best_state`.
    NeuroSyM's files do not say which of its networks they are, nor how alpha was weighted: the
    network is inferred from its tensors, and the weighting is the authors' table unless the file
    was exported from here.

    Args:
        contents: of the file; tensors are anything that numpy makes an array of.
        ignore: see `load_torch_checkpoint`.
        size: bytes of the file, which its tensors cannot exceed.

    Raises:
        InputError: naming what is missing or wrong.
    """
    if not isinstance(contents, dict):
        raise InputError("holds no dictionary: not a checkpoint of SGAN")
    given = contents.get("args")
    if not isinstance(contents.get("g_state"), dict) or not isinstance(given, dict):
        missing = "args" if isinstance(contents.get("g_state"), dict) else "g_state"
        raise InputError(f"has no {missing}: not a checkpoint of SGAN, or one without weights")
    refuse_unknown(given, ignore, ())
    arguments = {k: v for k, v in given.items() if isinstance(k, str) and _is_plain(v)}
    state = _plain(contents["g_state"], arguments, size)
    config = generator_config(arguments, state, "args")
    scene = arguments.get("dataset_name")
    dataset = scene if isinstance(scene, str) else None
    params = {"params": params_from_torch(state, config)}
    return Model(config, params, dataset, assumed=assumptions(arguments, config))


def export_torch_checkpoint(
    path: Path | str,
    config: GeneratorConfig,
    params: Mapping[str, Any],
    *,
    scene: str | None = None,
) -> None:
    """Write `torch_contents` with torch, which must be installed, as a `.pt` of weights only.

    Raises:
        InputError: when `path` cannot be written, torch is absent, or as `torch_contents`.
    """
    contents = torch_contents(config, params, scene=scene)
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


def torch_contents(
    config: GeneratorConfig, params: Mapping[str, Any], *, scene: str | None = None
) -> dict[str, Any]:
    """`args` and `g_state` as SGAN's code saves them, with arrays for tensors.

    The code is SGAN's, or for `neurosym_ros` and `neurosym_ijcnn` the release that each is named
    after. Their generators declare a second pooling, `pool_net_d`, that they never call; it is
    zeros, because `load_state_dict` insists on it.

    Raises:
        InputError: for a parameter that is missing, unexpected or misshapen, a configuration that
            SGAN's arguments cannot express, `as_described` and learned weightings, which torch does
            not have.
    """
    arguments: dict[str, Any] = {
        **EXPORTED,
        **{name: getattr(config, name) for name in SAME},
        **{f"{name}_g": getattr(config, name) for name in ("encoder_h_dim", "decoder_h_dim")},
        **{name: getattr(config.pooling, name, usual) for name, usual in UNUSED.items()},
        "pool_every_timestep": config.pool_every_timestep,
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
    if (width := getattr(config.pooling, "hidden_dim", 512)) != 512:
        raise InputError(f"SGAN's pool_hidden_dim is fixed at 512, not {width}")
    return {"g_state": params_to_torch(params, config), "args": arguments}


def _plain(state: Mapping[Any, Any], arguments: Mapping[str, Any], size: float) -> dict[str, Any]:
    if not all(isinstance(name, str) for name in state):
        raise InputError("g_state is not a state dict")
    shapes = [getattr(tensor, "shape", None) for tensor in state.values()]
    # Tensors that lie over each other may ask for any multiple of the file's size.
    if 2 * sum(math.prod(shape) for shape in shapes if isinstance(shape, tuple)) > size:
        raise InputError("its tensors have more elements than the file can hold")
    return plain_state(state, arguments)


def _is_plain(value: Any) -> bool:
    if isinstance(value, tuple | list):
        return all(not isinstance(part, tuple | list) and _is_plain(part) for part in value)
    # Python refuses to print integers of thousands of digits, which a damaged file may hold.
    is_number = isinstance(value, float) or (isinstance(value, int) and abs(value) < 2**63)
    return value is None or is_number or isinstance(value, str)
