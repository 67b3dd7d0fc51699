"""torch's parameter names and shapes of SGAN's and NeuroSyM's networks against ours.

One table of layers (torch's prefix, our path, kind, sizes), yielded for a configuration; both
directions and the checks for missing, unexpected and misshapen arrays derive from it. Our kernels
are `[in, out]`, torch's weights `[out, in]`; the LSTM's gates are i, f, g, o in both. It reads no
file and builds no network.
"""

import itertools
from collections.abc import Iterable, Mapping
from typing import Any, NamedTuple

import numpy as np

from neurosym_jax.errors import InputError
from neurosym_jax.forecasting.parameters import (
    flat_parameters,
    listed,
    nested_parameters,
    refuse_not_finite,
)
from neurosym_jax.models.config import DiscriminatorConfig, GeneratorConfig
from neurosym_jax.models.lstm import LSTM
from neurosym_jax.models.neurosym import NeurosymIjcnn, NeurosymRos
from neurosym_jax.models.pool_net import PoolNet
from neurosym_jax.models.poolings import POOLINGS
from neurosym_jax.models.social import Social

__all__ = ["params_from_torch", "params_to_torch"]

Config = GeneratorConfig | DiscriminatorConfig


class _Layer(NamedTuple):
    """One row of the table: torch's prefix, our path, the kind of layer, its sizes."""

    torch: str
    ours: str | None
    """None for a layer that torch's code declares and never calls, which we do not have."""
    kind: str
    inputs: int
    outputs: int


class _Leaf(NamedTuple):
    """One array: its two names, and our shape; torch's array is ours transposed."""

    torch: str
    ours: str | None
    shape: tuple[int, ...]


def params_from_torch(state: Mapping[str, Any], config: Config) -> dict[str, Any]:
    """Our nested float32 parameters from torch's flat state dict of arrays.

    Raises:
        InputError: naming the tensors that `config` needs and `state` lacks, those that it has
            and the network does not, and those of another shape; for `as_described`.
    """
    leaves = _leaves(config)
    unused = {leaf.torch for leaf in leaves if leaf.ours is None}
    needed = {leaf.torch: leaf.shape[::-1] for leaf in leaves if leaf.ours}
    arrays = _checked({k: v for k, v in state.items() if k not in unused}, needed, config)
    return nested_parameters(
        {leaf.ours: np.ascontiguousarray(arrays[leaf.torch].T) for leaf in leaves if leaf.ours}
    )


def params_to_torch(params: Mapping[str, Any], config: Config) -> dict[str, np.ndarray]:
    """The inverse of `params_from_torch`, with the same errors by our names."""
    leaves = _leaves(config)
    ours = {leaf.ours: leaf.shape for leaf in leaves if leaf.ours}
    arrays = _checked(flat_parameters(params), ours, config)
    # `load_state_dict` wants every tensor that the code declares; zeros stand for those unused.
    return {
        leaf.torch: np.ascontiguousarray(arrays[leaf.ours].T)
        if leaf.ours
        else np.zeros(leaf.shape[::-1], np.float32)
        for leaf in leaves
    }


def _generator_layers(c: GeneratorConfig) -> Iterable[_Layer]:
    if not isinstance(c.cell, LSTM):
        raise InputError(f"a {c.cell.title} has no counterpart in torch: SGAN has an LSTM")
    pooled = c.pooling.width(c.encoder_h_dim)
    yield _Layer("encoder.encoder", "encoder/lstm", "lstm", c.embedding_dim, c.encoder_h_dim)
    yield _Layer(
        "encoder.spatial_embedding", "encoder/spatial_embedding", "dense", 2, c.embedding_dim
    )
    yield _Layer("decoder.decoder", "decoder/lstm", "lstm", c.embedding_dim, c.decoder_h_dim)
    if c.pool_every_timestep and c.symbolic:
        raise InputError(
            f"pool_every_timestep with {POOLINGS.name_of(c.pooling)} has no counterpart in torch: "
            "the released networks have no symbols of predicted steps"
        )
    if c.pool_every_timestep:
        yield from _pooling_layers("decoder.pool_net", "decoder/pooling", c, c.decoder_h_dim)
        widths = (c.decoder_h_dim + pooled, c.mlp_dim, c.decoder_h_dim)
        yield from _mlp_layers("decoder.mlp", "decoder/mlp", widths)
    yield _Layer(
        "decoder.spatial_embedding", "decoder/spatial_embedding", "dense", 2, c.embedding_dim
    )
    yield _Layer("decoder.hidden2pos", "decoder/hidden2pos", "dense", c.decoder_h_dim, 2)
    yield from _pooling_layers("pool_net", "pooling", c, c.encoder_h_dim)
    if c.needs_context_mlp:
        widths = (c.encoder_h_dim + pooled, c.mlp_dim, c.decoder_h_dim - c.noise_dim)
        yield from _mlp_layers("mlp_decoder_context", "context_mlp", widths)


def _pooling_layers(torch: str, ours: str, c: GeneratorConfig, h_dim: int) -> Iterable[_Layer]:
    pooling = c.pooling
    if type(pooling) is PoolNet:
        sizes = (c.embedding_dim, h_dim, pooling.hidden_dim, pooling.bottleneck_dim)
        yield from _pool_net_layers(torch, ours, *sizes)
    elif isinstance(pooling, Social):
        sizes = (pooling.grid_size**2 * h_dim, h_dim)
        yield from _mlp_layers(f"{torch}.mlp_pool", f"{ours}/mlp", sizes)
    elif isinstance(pooling, NeurosymRos | NeurosymIjcnn):
        width = c.obs_len * c.embedding_dim
        # The robot package embeds the whole history at once, the earlier release each step.
        whole = isinstance(pooling, NeurosymRos)
        embedding = (2 * c.obs_len, width) if whole else (2, c.embedding_dim)
        yield _Layer(
            f"{torch}_g.spatial_embedding", f"{ours}/spatial_embedding", "dense", *embedding
        )
        widths = (width + h_dim, pooling.hidden_dim, pooling.bottleneck_dim)
        yield from _mlp_layers(f"{torch}_g.mlp_pre_pool", f"{ours}/mlp", widths)
        sizes = (c.embedding_dim, h_dim, pooling.hidden_dim, pooling.bottleneck_dim)
        yield from _pool_net_layers(f"{torch}_d", None, *sizes)
    elif c.pools:
        # The arrays of as_described have the shapes of neurosym_ijcnn's, and would do something
        # else there.
        raise InputError(
            f"pooling {POOLINGS.name_of(pooling)} has no counterpart in torch: the released "
            "networks are pool_net, social, neurosym_ros and neurosym_ijcnn"
        )


def _discriminator_layers(c: DiscriminatorConfig) -> Iterable[_Layer]:
    yield _Layer("encoder.encoder", "encoder/lstm", "lstm", c.embedding_dim, c.h_dim)
    yield _Layer(
        "encoder.spatial_embedding", "encoder/spatial_embedding", "dense", 2, c.embedding_dim
    )
    yield from _mlp_layers("real_classifier", "classifier", (c.h_dim, c.mlp_dim, 1))
    if c.kind == "global":
        sizes = (c.embedding_dim, c.h_dim, c.pool_hidden_dim, c.h_dim)
        yield from _pool_net_layers("pool_net", "pooling", *sizes)


def _pool_net_layers(
    torch: str, ours: str | None, embedding_dim: int, h_dim: int, hidden_dim: int, out_dim: int
) -> Iterable[_Layer]:
    embedding = _within(ours, "spatial_embedding")
    yield _Layer(f"{torch}.spatial_embedding", embedding, "dense", 2, embedding_dim)
    widths = (embedding_dim + h_dim, hidden_dim, out_dim)
    yield from _mlp_layers(f"{torch}.mlp_pre_pool", _within(ours, "mlp"), widths)


def _mlp_layers(torch: str, ours: str | None, widths: tuple[int, ...]) -> Iterable[_Layer]:
    # torch numbers the ReLU between two layers as well, hence 0, 2, ...
    for i, (inputs, outputs) in enumerate(itertools.pairwise(widths)):
        yield _Layer(f"{torch}.{2 * i}", _within(ours, f"layer_{i}"), "dense", inputs, outputs)


def _within(ours: str | None, name: str) -> str | None:
    return ours and f"{ours}/{name}"


def _leaves(config: Config) -> list[_Leaf]:
    is_generator = isinstance(config, GeneratorConfig)
    layers = _generator_layers(config) if is_generator else _discriminator_layers(config)
    return [leaf for layer in layers for leaf in _of_layer(*layer)]


def _of_layer(
    torch: str, ours: str | None, kind: str, inputs: int, outputs: int
) -> Iterable[_Leaf]:
    gates = 4 * outputs
    names = {
        "dense": {
            ("weight", "kernel"): (inputs, outputs),
            ("bias", "bias"): (outputs,),
        },
        "lstm": {
            ("weight_ih_l0", "input_kernel"): (inputs, gates),
            ("weight_hh_l0", "recurrent_kernel"): (outputs, gates),
            ("bias_ih_l0", "input_bias"): (gates,),
            ("bias_hh_l0", "recurrent_bias"): (gates,),
        },
    }
    for (theirs, name), shape in names[kind].items():
        yield _Leaf(f"{torch}.{theirs}", _within(ours, name), shape)


def _checked(
    arrays: Mapping[str, Any], shapes: Mapping[str, tuple[int, ...]], config: Config
) -> dict[str, np.ndarray]:
    """The arrays as float32, once their names and shapes are exactly `shapes`."""
    what = "generator" if isinstance(config, GeneratorConfig) else "discriminator"
    # A damaged file may hold anything at all under a tensor's name: that has no shape.
    shaped = {name: getattr(array, "shape", None) for name, array in arrays.items()}
    found = {k: shape if isinstance(shape, tuple) else () for k, shape in shaped.items()}
    faults = {
        "missing": [repr(name) for name in shapes if name not in found],
        "unexpected": [repr(name) for name in found if name not in shapes],
        "of another shape": [
            f"{name!r} is {list(found[name])}, not {list(shape)}"
            for name, shape in shapes.items()
            if name in found and found[name] != shape
        ],
    }
    if any(faults.values()):
        words = (f"{fault}: {listed(names)}" for fault, names in faults.items() if names)
        raise InputError(
            f"the {what}'s parameters do not fit its configuration: " + "; ".join(words)
        )
    values = {name: np.asarray(array) for name, array in arrays.items()}
    if wrong := [repr(name) for name, array in values.items() if array.dtype.kind != "f"]:
        raise InputError(f"the {what}'s parameters are not floating point: {listed(wrong)}")
    refuse_not_finite(values)
    return {name: array.astype(np.float32, copy=False) for name, array in values.items()}
