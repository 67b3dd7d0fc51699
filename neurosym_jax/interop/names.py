"""torch's parameter names and shapes of SGAN's and NeuroSyM's networks against ours.

One table of layers (torch's prefix, our path, kind, sizes), yielded for a configuration; both
directions and the checks for missing, unexpected and misshapen arrays derive from it. Our kernels
are `[in, out]`, torch's weights `[out, in]`; the LSTM's gates are i, f, g, o in both. It reads no
file and builds no network.
"""

import itertools
import re
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

__all__ = ["Layer", "layers_of", "params_from_torch", "params_to_torch", "plain_state"]

Config = GeneratorConfig | DiscriminatorConfig

NUMBERED = re.compile(
    r"((?:.+\.)?(?:mlp_pre_pool|mlp_pool|mlp_decoder_context|mlp|real_classifier))\.(\d+)\.(\w+)"
)
"""A tensor in one of SGAN's perceptrons: the perceptron, the number of the layer, the tensor."""
EPSILON = 1e-5
"""Of torch's BatchNorm1d."""


class Layer(NamedTuple):
    """One row of the table."""

    torch: str
    """torch's prefix."""
    ours: str | None
    """None for a layer that torch's code declares and never calls, which we do not have."""
    kind: str
    """`dense`, `lstm` or `mlp`."""
    sizes: tuple[int, ...]
    """Inputs, hidden sizes of an mlp, outputs."""


class _Leaf(NamedTuple):
    """One array: its two names, and our shape; torch's array is ours transposed."""

    torch: str
    ours: str | None
    shape: tuple[int, ...]


def plain_state(state: Mapping[str, Any], arguments: Mapping[str, Any]) -> dict[str, Any]:
    """The tensors as SGAN's code names and computes them without dropout and batch norm.

    Both take numbers in a perceptron, whose second layer is then 3 or 4, not 2. Batch norm with its
    running statistics is an affine map, and folds into the layer before it.

    Raises:
        InputError: for batch norm that the arguments deny, assert in vain or that has no layer.
    """
    plain: dict[str, Any] = {}
    perceptrons: dict[str, dict[int, dict[str, Any]]] = {}
    for name, tensor in state.items():
        if match := NUMBERED.fullmatch(name):
            perceptrons.setdefault(match[1], {}).setdefault(int(match[2]), {})[match[3]] = tensor
        else:
            plain[name] = tensor
    norms = any("running_mean" in layer for m in perceptrons.values() for layer in m.values())
    if perceptrons and bool(arguments.get("batch_norm", norms)) != norms:
        have = "with" if norms else "without"
        raise InputError(f"batch_norm is {arguments['batch_norm']!r}, the weights are {have} it")
    # Not every perceptron of the released code has the dropout.
    steps = {2 + norms, 2 + norms + bool(arguments.get("dropout"))}
    for prefix, layers in perceptrons.items():
        dense = [n for n in sorted(layers) if "running_mean" not in layers[n]]
        gaps = {b - a for a, b in itertools.pairwise(dense)}
        regular = dense[:1] == [0] and len(gaps) < 2 and gaps <= steps
        for rank, number in enumerate(dense):
            tensors = layers[number]
            if norms:
                tensors = _folded(prefix, tensors, layers.get(number + 1, {}))
            number = 2 * rank if regular else number
            plain |= {f"{prefix}.{number}.{name}": tensor for name, tensor in tensors.items()}
    return plain


def _folded(prefix: str, dense: dict[str, Any], norm: dict[str, Any]) -> dict[str, Any]:
    """A dense layer with the batch norm after it."""
    wanted = {"weight", "bias", "running_mean", "running_var"}
    if dense.keys() != {"weight", "bias"} or norm.keys() - {"num_batches_tracked"} != wanted:
        raise InputError(f"{prefix}: not every layer is followed by a batch norm")
    arrays = [
        np.asarray(tensor) for tensor in (*dense.values(), *(norm[k] for k in sorted(wanted)))
    ]
    if any(a.dtype.kind != "f" or a.shape[:1] != arrays[0].shape[:1] or a.ndim > 2 for a in arrays):
        raise InputError(f"{prefix}: a batch norm does not fit its layer")
    given = {name: np.asarray(tensor, np.float64) for name, tensor in norm.items()}
    weight, bias = (np.asarray(dense[name], np.float64) for name in ("weight", "bias"))
    scale = given["weight"] / np.sqrt(given["running_var"] + EPSILON)
    shifted = (bias - given["running_mean"]) * scale + given["bias"]
    return {"weight": weight * scale[:, None], "bias": shifted}


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


def _generator_layers(c: GeneratorConfig) -> Iterable[Layer]:
    if not isinstance(c.cell, LSTM):
        raise InputError(f"a {c.cell.title} has no counterpart in torch: SGAN has an LSTM")
    pooled = c.pooling.width(c.encoder_h_dim)
    yield Layer("encoder.encoder", "encoder/lstm", "lstm", (c.embedding_dim, c.encoder_h_dim))
    yield Layer(
        "encoder.spatial_embedding", "encoder/spatial_embedding", "dense", (2, c.embedding_dim)
    )
    yield Layer("decoder.decoder", "decoder/lstm", "lstm", (c.embedding_dim, c.decoder_h_dim))
    if c.pool_every_timestep and c.symbolic:
        raise InputError(
            f"pool_every_timestep with {POOLINGS.name_of(c.pooling)} has no counterpart in torch: "
            "the released networks have no symbols of predicted steps"
        )
    if c.pool_every_timestep:
        yield from _pooling_layers("decoder.pool_net", "decoder/pooling", c, c.decoder_h_dim)
        widths = (c.decoder_h_dim + pooled, c.mlp_dim, c.decoder_h_dim)
        yield Layer("decoder.mlp", "decoder/mlp", "mlp", widths)
    yield Layer(
        "decoder.spatial_embedding", "decoder/spatial_embedding", "dense", (2, c.embedding_dim)
    )
    yield Layer("decoder.hidden2pos", "decoder/hidden2pos", "dense", (c.decoder_h_dim, 2))
    yield from _pooling_layers("pool_net", "pooling", c, c.encoder_h_dim)
    if c.needs_context_mlp:
        widths = (c.encoder_h_dim + pooled, c.mlp_dim, c.decoder_h_dim - c.noise_dim)
        yield Layer("mlp_decoder_context", "context_mlp", "mlp", widths)


def _pooling_layers(torch: str, ours: str, c: GeneratorConfig, h_dim: int) -> Iterable[Layer]:
    pooling = c.pooling
    if type(pooling) is PoolNet:
        sizes = (c.embedding_dim, h_dim, pooling.hidden_dim, pooling.bottleneck_dim)
        yield from _pool_net_layers(torch, ours, *sizes)
    elif isinstance(pooling, Social):
        sizes = (pooling.grid_size**2 * h_dim, h_dim)
        yield Layer(f"{torch}.mlp_pool", f"{ours}/mlp", "mlp", sizes)
    elif isinstance(pooling, NeurosymRos | NeurosymIjcnn):
        width = c.obs_len * c.embedding_dim
        # The robot package embeds the whole history at once, the earlier release each step.
        whole = isinstance(pooling, NeurosymRos)
        embedding = (2 * c.obs_len, width) if whole else (2, c.embedding_dim)
        yield Layer(f"{torch}_g.spatial_embedding", f"{ours}/spatial_embedding", "dense", embedding)
        widths = (width + h_dim, pooling.hidden_dim, pooling.bottleneck_dim)
        yield Layer(f"{torch}_g.mlp_pre_pool", f"{ours}/mlp", "mlp", widths)
        sizes = (c.embedding_dim, h_dim, pooling.hidden_dim, pooling.bottleneck_dim)
        yield from _pool_net_layers(f"{torch}_d", None, *sizes)
    elif c.pools:
        # The arrays of as_described have the shapes of neurosym_ijcnn's, and would do something
        # else there.
        raise InputError(
            f"pooling {POOLINGS.name_of(pooling)} has no counterpart in torch: the released "
            "networks are pool_net, social, neurosym_ros and neurosym_ijcnn"
        )


def _discriminator_layers(c: DiscriminatorConfig) -> Iterable[Layer]:
    yield Layer("encoder.encoder", "encoder/lstm", "lstm", (c.embedding_dim, c.h_dim))
    yield Layer(
        "encoder.spatial_embedding", "encoder/spatial_embedding", "dense", (2, c.embedding_dim)
    )
    yield Layer("real_classifier", "classifier", "mlp", (c.h_dim, c.mlp_dim, 1))
    if c.kind == "global":
        sizes = (c.embedding_dim, c.h_dim, c.pool_hidden_dim, c.h_dim)
        yield from _pool_net_layers("pool_net", "pooling", *sizes)


def _pool_net_layers(
    torch: str, ours: str | None, embedding_dim: int, h_dim: int, hidden_dim: int, out_dim: int
) -> Iterable[Layer]:
    embedding = _within(ours, "spatial_embedding")
    yield Layer(f"{torch}.spatial_embedding", embedding, "dense", (2, embedding_dim))
    widths = (embedding_dim + h_dim, hidden_dim, out_dim)
    yield Layer(f"{torch}.mlp_pre_pool", _within(ours, "mlp"), "mlp", widths)


def _within(ours: str | None, name: str) -> str | None:
    return ours and f"{ours}/{name}"


def layers_of(config: Config) -> list[Layer]:
    """The table of a configuration's network.

    Raises:
        InputError: for a network that torch's released code does not have.
    """
    is_generator = isinstance(config, GeneratorConfig)
    return list(_generator_layers(config) if is_generator else _discriminator_layers(config))


def _leaves(config: Config) -> list[_Leaf]:
    return [leaf for layer in layers_of(config) for leaf in _of_layer(layer)]


def _of_layer(layer: Layer) -> Iterable[_Leaf]:
    if layer.kind == "mlp":
        # torch numbers the ReLU between two layers as well, hence 0, 2, ...
        for i, sizes in enumerate(itertools.pairwise(layer.sizes)):
            ours = _within(layer.ours, f"layer_{i}")
            yield from _of_layer(Layer(f"{layer.torch}.{2 * i}", ours, "dense", sizes))
        return
    inputs, outputs = layer.sizes
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
    for (theirs, name), shape in names[layer.kind].items():
        yield _Leaf(f"{layer.torch}.{theirs}", _within(layer.ours, name), shape)


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
