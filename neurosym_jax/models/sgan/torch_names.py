"""Parameters of SGAN's and NeuroSyM's networks by torch's names, and by ours.

Our paths and shapes are those of our networks; a table of words turns a path into
torch's name. Our kernels are `[in, out]`, torch's weights `[out, in]`; an LSTM's gates
are i, f, g, o in both.
"""

import dataclasses
import re
from collections.abc import Mapping
from typing import Any

import jax
import numpy as np

from neurosym_jax.errors import InputError, brief
from neurosym_jax.models.forecaster import (
    flat_parameters,
    nested_parameters,
    refuse_misfit,
    shapes_of,
)
from neurosym_jax.models.sgan.forecaster import GeneratorForecaster
from neurosym_jax.models.sgan.network import (
    LSTM,
    AsDescribed,
    Discriminator,
    DiscriminatorConfig,
    GeneratorConfig,
    NeurosymIjcnn,
    NeurosymRos,
    NoPooling,
    PoolNet,
    Social,
)
from neurosym_jax.scene import model_dtype

__all__ = ["params_from_torch", "params_to_torch", "torch_names", "without_dropout"]

Config = GeneratorConfig | DiscriminatorConfig

WORDS = {
    "encoder/lstm": "encoder.encoder",
    "decoder/lstm": "decoder.decoder",
    "context_mlp": "mlp_decoder_context",
    "classifier": "real_classifier",
    "pooling/mlp": "pool_net.mlp_pre_pool",
    "pooling": "pool_net",
    "input_kernel": "weight_ih_l0",
    "recurrent_kernel": "weight_hh_l0",
    "input_bias": "bias_ih_l0",
    "recurrent_bias": "bias_hh_l0",
    "kernel": "weight",
    # torch numbers the ReLU between two layers as well.
    "layer_0": "0",
    "layer_1": "2",
    "/": ".",
}
"""Parts of our paths, and what stands there in torch's names; replaced in this order."""
RELEASED = (NoPooling, PoolNet, Social, NeurosymRos, NeurosymIjcnn)
UNUSED = "pool_net_d."
"""Prefix of a second pooling, which NeuroSyM's generators declare and never call."""


def torch_names(config: Config) -> dict[str, tuple[str, tuple[int, ...]]]:
    """Our path and our shape of each parameter, by torch's name.

    Raises:
        InputError: for a network that torch's released code does not have.
    """
    words = dict(WORDS)
    if isinstance(config, DiscriminatorConfig):
        track = np.zeros((1, 2, 2))
        inputs = jax.random.key(0), track, track, np.ones(1, bool)
        shapes = jax.eval_shape(Discriminator(config).init, *inputs)
    else:
        pooling = config.pooling
        forecaster = GeneratorForecaster(config)
        shapes = forecaster.shapes()
        # Some networks that the released code lacks have the arrays of another.
        later = config.pool_every_timestep and config.symbolic
        if later or not isinstance(config.cell, LSTM) or type(pooling) not in RELEASED:
            raise InputError(
                f"{forecaster.title} has no counterpart in torch: SGAN has an LSTM, and the "
                "released poolings are none, pool_net, social and, at observed steps only, "
                "neurosym_ros and neurosym_ijcnn"
            )
        if isinstance(pooling, AsDescribed):
            words["pool_net"] = "pool_net_g"
        if isinstance(pooling, Social):
            words["mlp_pre_pool"] = "mlp_pool"
    names = {}
    for path, shape in shapes_of(shapes["params"]).items():
        name = path
        for part, torch_part in words.items():
            name = name.replace(part, torch_part)
        names[name] = path, shape
    return names


def without_dropout(
    state: Mapping[str, Any], arguments: Mapping[str, Any]
) -> dict[str, Any]:
    """The tensors by their names without dropout, which takes a number in a perceptron."""
    if not arguments.get("dropout"):
        return dict(state)
    renamed = {}
    for name, tensor in state.items():
        renamed[re.sub(r"(mlp\w*|real_classifier)\.3\.", r"\1.2.", name)] = tensor
    return renamed


def params_from_torch(state: Mapping[str, Any], config: Config) -> dict[str, Any]:
    """Our nested parameters from torch's flat state dict of arrays.

    They are float32, or with x64 enabled float64 where torch's are.

    Raises:
        InputError: naming the tensors that `config` needs and `state` lacks, those that
            it has and the network does not, and those of another shape; for
            `as_described`.
    """
    names = torch_names(config)
    shapes = {name: shape[::-1] for name, (_, shape) in names.items()}
    used = {name: state[name] for name in state if not name.startswith(UNUSED)}
    arrays = _checked(used, shapes, config)
    params = {}
    for name, (path, _) in names.items():
        # A copy: torch goes on training the arrays that it was asked for.
        params[path] = np.array(arrays[name].T, order="C")
    return nested_parameters(params)


def params_to_torch(params: Mapping[str, Any], config: Config) -> dict[str, np.ndarray]:
    """The inverse of `params_from_torch`, with the same errors by our names.

    `load_state_dict` wants every tensor that the code declares: those that NeuroSyM's
    generators never use are zeros.
    """
    names = torch_names(config)
    arrays = _checked(flat_parameters(params), dict(names.values()), config)
    state = {}
    for name, (path, _) in names.items():
        state[name] = np.ascontiguousarray(arrays[path].T)
    if isinstance(config, GeneratorConfig) and isinstance(config.pooling, AsDescribed):
        pooling = PoolNet(**vars(config.pooling))
        sgan = dataclasses.replace(config, weighting=None, pooling=pooling)
        for name, (_, shape) in torch_names(sgan).items():
            if name.startswith("pool_net."):
                unused = name.replace("pool_net.", UNUSED)
                state[unused] = np.zeros(shape[::-1], np.float32)
    return state


def _checked(
    arrays: Mapping[str, Any], shapes: Mapping[str, tuple[int, ...]], config: Config
) -> dict[str, np.ndarray]:
    """The arrays as floats, once their names and shapes are exactly `shapes`."""
    for name, array in arrays.items():
        if array.dtype.kind != "f":
            raise InputError(f"{brief(name)} is not floating point")
    part = "generator" if isinstance(config, GeneratorConfig) else "discriminator"
    refuse_misfit(
        arrays, shapes, f"the {part}'s parameters do not fit its configuration"
    )
    floats = {}
    for name, array in arrays.items():
        dtype = model_dtype() if array.dtype == model_dtype() else np.float32
        floats[name] = array.astype(dtype, copy=False)
    return floats
