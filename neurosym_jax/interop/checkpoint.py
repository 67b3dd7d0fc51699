"""Torch checkpoints of SGAN and NeuroSyM: read without torch, written with it.

A network's widths are read from the shapes of its weights, everything else from the
arguments.
"""

import dataclasses
import os
import re
from collections import OrderedDict
from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from neurosym_jax.configuration import from_json
from neurosym_jax.errors import InputError, brief
from neurosym_jax.interop.pickles import read_torch_file
from neurosym_jax.models.forecast import Model
from neurosym_jax.models.sgan.network import (
    POOLINGS,
    DiscriminatorConfig,
    GeneratorConfig,
    Social,
)
from neurosym_jax.models.sgan.torch_names import (
    params_from_torch,
    params_to_torch,
    without_dropout,
)
from neurosym_jax.runtime.files import new_file
from neurosym_jax.symbolic.weighting import initial_parameters

__all__ = [
    "Contents",
    "discriminator",
    "export_torch_checkpoint",
    "generator",
    "left_out",
    "load_torch_checkpoint",
    "model_from_torch",
    "released_config",
    "torch_contents",
]

Contents = Mapping[str, Any]
"""What a file of torch holds, by name: `args`, `g_state`, ..."""
WRAPPERS = re.compile(r"^module\.|\b_orig_mod\.")
"""What DataParallel and `torch.compile` put before the names of tensors."""

TORCH_POOLING = {"none": "none", "pool_net": "pool_net", "social": "spool"}
"""SGAN's names of the poolings; NeuroSyM's code calls its own `pool_net` as well."""
SAME = (
    "obs_len",
    "pred_len",
    "noise_dim",
    "noise_type",
    "noise_mix_type",
    "pool_every_timestep",
)
"""Arguments that are fields of ours, and that no weight says."""
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
POOLING_OPTIONS = {"bottleneck_dim": 8, "neighborhood_size": 2.0, "grid_size": 8}
"""SGAN's constructor takes all of them, whichever pooling it builds."""
READ_BY_EVALUATION = {
    "delim": "tab",
    "skip": 1,
    "batch_size": 64,
    "loader_num_workers": 4,
}
"""Arguments that SGAN's evaluation script looks for in a checkpoint."""
PASSED = (
    "dropout neighborhood_size grid_size weighting d_type h_dim encoder_h_dim_d encoder_h_dim_g "
    "decoder_h_dim_g pooling_type "
    "dataset_name delim loader_num_workers skip batch_size num_iterations num_epochs best_k "
    "clipping_threshold_g clipping_threshold_d g_learning_rate d_learning_rate g_steps d_steps "
    "l2_loss_weight output_dir print_every checkpoint_every checkpoint_name checkpoint_start_from "
    "restore_from_checkpoint num_samples_check use_gpu timing gpu_num labels_dir filename"
)
"""Further arguments of the released code, most of its training."""


def load_torch_checkpoint(
    path: str | os.PathLike, ignored: Collection[str] | None = ()
) -> Model:
    """The generator that SGAN, NeuroSyM or `export_torch_checkpoint` wrote to `path`.

    Args:
        path: the file.
        ignored: names of unknown arguments that do not change the network; None for
            all.

    Raises:
        InputError: naming `path` and what is missing or wrong: an unreadable, damaged
            or foreign file, an argument, a tensor.
    """
    contents = read_torch_file(path)
    try:
        return model_from_torch(contents, ignored)
    except InputError as error:
        raise InputError(f"{path}: {error}") from None


def model_from_torch(contents: Any, ignored: Collection[str] | None = ()) -> Model:
    """The generator in the dictionary that SGAN's training saves.

    It is `g_state`, which SGAN's own evaluation uses, never `g_best_state`. NeuroSyM's
    files do not say which of its networks they are, nor how alpha was weighted: the
    network is inferred from its tensors, and the weighting is the authors' table unless
    the file was exported from here.

    Raises:
        InputError: naming what is missing or wrong.
    """
    for name in ("g_state", "args"):
        if not isinstance(contents, dict) or not isinstance(contents.get(name), dict):
            raise InputError(
                f"has no {name}: not a checkpoint of SGAN, or one without weights"
            )
    arguments = {str(name): value for name, value in contents["args"].items()}
    unknown = sorted(set(arguments) - {*SAME, *FIXED, *WIDTHS, *PASSED.split()})
    refused = [name for name in unknown if ignored is not None and name not in ignored]
    if refused:
        raise InputError(
            f"unknown argument {brief(refused[0])}, which may change the network: if it does not, "
            f"`ignored` names it (neurosym convert --ignore-arg {refused[0][:80]})"
        )
    state = {}
    for name, tensor in contents["g_state"].items():
        if not isinstance(name, str) or not isinstance(tensor, np.ndarray):
            raise InputError(f"g_state is not a state dict: {brief(name)} is no tensor")
        state[WRAPPERS.sub("", name)] = tensor
    config, params = generator(arguments, state)
    assumed = ["forward as in the released code"]
    if state.keys() != contents["g_state"].keys():
        assumed.append(
            "without the prefixes module. and _orig_mod. of torch's wrappers"
        )
    if "activation" not in arguments:
        assumed.append("activation relu")
    if config.weighting is not None and "weighting" not in arguments:
        assumed.append(f"pairs weighted by {config.weighting.name}")
    assumed += [f"the unknown argument {name} changes nothing" for name in unknown]
    dataset = arguments.get("dataset_name")
    return Model(
        config,
        {"params": params},
        dataset if isinstance(dataset, str) else None,
        assumed=tuple(assumed),
    )


def export_torch_checkpoint(path: Path | str, model: Model) -> None:
    """Write `torch_contents` with torch, which must be installed, as a `.pt` of weights only.

    Raises:
        InputError: when `path` cannot be written, torch is absent, or as
            `torch_contents`.
    """
    contents = torch_contents(model)
    try:
        import torch  # pyright: ignore[reportMissingImports]
    except ImportError:
        raise InputError(
            f"{path}: torch writes it, and is not installed here"
        ) from None
    if os.path.exists(path):
        raise InputError(f"{path}: exists already")
    state = contents["g_state"].items()
    contents["g_state"] = OrderedDict(
        (name, torch.from_numpy(array)) for name, array in state
    )
    with new_file(path) as beside:
        torch.save(contents, beside)


def torch_contents(model: Model) -> dict[str, Any]:
    """`args` and `g_state` as SGAN's code saves them, with arrays for tensors.

    The code is SGAN's, or for `neurosym_ros` and `neurosym_ijcnn` the release that each
    is named after.

    Raises:
        InputError: for a network that SGAN's arguments cannot express, `as_described`
            and learned weightings, which torch does not have.
    """
    config = released_config(model)
    pooling, weighting = config.pooling, config.weighting
    if weighting is not None and initial_parameters(weighting):
        raise InputError(f"the weights {weighting.name} are learned: no torch has them")
    width = getattr(pooling, "hidden_dim", 512)
    if width != 512:
        raise InputError(f"SGAN's pool_hidden_dim is fixed at 512, not {width}")
    arguments: dict[str, Any] = {**FIXED, **READ_BY_EVALUATION}
    for name in (*SAME, "embedding_dim", "mlp_dim"):
        arguments[name] = getattr(config, name)
    for name in ("encoder_h_dim", "decoder_h_dim"):
        arguments[f"{name}_g"] = getattr(config, name)
    for name, usual in POOLING_OPTIONS.items():
        arguments[name] = getattr(pooling, name, usual)
    kind = POOLINGS.name_of(pooling)
    arguments["dropout"] = 0.0
    arguments["noise_dim"] = (config.noise_dim,)
    arguments["pooling_type"] = TORCH_POOLING.get(kind, "pool_net")
    arguments["dataset_name"] = model.dataset
    if isinstance(pooling, Social):
        arguments["bottleneck_dim"] = config.encoder_h_dim
    if weighting is not None:
        # No argument of the released code's, whose weighting is the data's; it passes
        # over it.
        arguments["weighting"] = weighting.name
    return {
        "g_state": params_to_torch(model.params["params"], config),
        "args": arguments,
    }


def left_out(contents: Contents, model: Model) -> list[str]:
    """Names of what a checkpoint holds and `model`, which was read from it, does not give back."""
    back = torch_contents(model)
    names = [str(part) for part in contents if part not in back]
    for part, values in back.items():
        for name, value in contents[part].items():
            is_unchanged = name in values and np.array_equal(value, values[name])
            names += [] if is_unchanged else [f"{part} {name}"]
    return names


def released_config(model: Model) -> GeneratorConfig:
    """The configuration of a model that torch's code may have.

    Raises:
        InputError: for anchors and other forecasters.
    """
    if not isinstance(model.config, GeneratorConfig):
        raise InputError(f"{model.name} has no counterpart in torch")
    return model.config


def generator(
    arguments: Mapping[str, Any], state: Mapping[str, Any]
) -> tuple[GeneratorConfig, dict[str, Any]]:
    """Configuration and parameters of the generator of these arguments and weights.

    Args:
        arguments: of SGAN's training or of its generator.
        state: arrays by torch's names; they say which of NeuroSyM's networks it is.

    Raises:
        InputError: naming an argument that is missing or that our networks lack, or a
            tensor.
    """
    state = without_dropout(state, arguments)
    fields = _required(arguments, (*SAME, "pooling_type")) | _widths(state)
    normed = [name for name in state if name.endswith("running_mean")]
    if normed:
        raise InputError(f"{normed[0]}: our networks have no batch norm")
    noise = fields["noise_dim"] or 0
    if isinstance(noise, tuple | list) and len(noise) == 1:
        noise = noise[0]
    fields["noise_dim"] = noise
    fields["pool_every_timestep"] = bool(fields["pool_every_timestep"])
    kinds = {torch_name: name for name, torch_name in TORCH_POOLING.items()}
    history = state.get("pool_net_g.spatial_embedding.weight")
    if history is not None:
        kinds = {
            "pool_net": "neurosym_ijcnn" if history.shape[-1] == 2 else "neurosym_ros"
        }
    if "neurosym_ros" in kinds.values():
        fields["weighting"] = arguments.get("weighting", "cnd_shipped")
    pooling = "none" if fields["pooling_type"] is None else fields["pooling_type"]
    kind = kinds.get(pooling.lower()) if isinstance(pooling, str) else None
    if kind is None:
        names = str([*kinds])[1:-1]
        raise InputError(f"args: pooling_type is one of {names}, not {brief(pooling)}")
    if kind == "social":
        fields |= _required(arguments, ("neighborhood_size", "grid_size"))
    fields["pooling"] = {"kind": kind, **_fields_of(POOLINGS[kind], fields)}
    config = from_json(GeneratorConfig, _fields_of(GeneratorConfig, fields), "args")
    return config, params_from_torch(state, config)


def discriminator(
    arguments: Mapping[str, Any], state: Mapping[str, Any]
) -> tuple[DiscriminatorConfig, dict[str, Any]]:
    """Configuration and parameters of the discriminator; raises as `generator`."""
    state = without_dropout(state, arguments)
    names = {"encoder_h_dim": "h_dim", "hidden_dim": "pool_hidden_dim"}
    fields: dict[str, Any] = {}
    for name, width in _widths(state).items():
        fields[names.get(name, name)] = width
    fields["kind"] = _required(arguments, ["d_type"])["d_type"]
    config = from_json(
        DiscriminatorConfig, _fields_of(DiscriminatorConfig, fields), "args"
    )
    return config, params_from_torch(state, config)


def _required(arguments: Mapping[str, Any], names: Collection[str]) -> dict[str, Any]:
    for name, value in FIXED.items():
        argument = arguments.get(name, value)
        if argument != value:
            raise InputError(
                f"args: {name} is {brief(argument)}, and our networks have {value!r} only"
            )
    missing = set(names) - set(arguments)
    if missing:
        raise InputError(f"args: {min(missing)} is missing")
    return {name: arguments[name] for name in names}


def _widths(state: Mapping[str, Any]) -> dict[str, int]:
    """Our fields that are widths, where a weight has them."""
    widths = {}
    for field, (pattern, axis) in WIDTHS.items():
        for name, array in state.items():
            if re.fullmatch(pattern, name) and array.ndim == 2:
                widths[field] = array.shape[axis]
    return widths


def _fields_of(config: type, values: Mapping[str, Any]) -> dict[str, Any]:
    """Those of `values` that are fields of `config`."""
    names = {field.name for field in dataclasses.fields(config)}
    return {name: value for name, value in values.items() if name in names}
