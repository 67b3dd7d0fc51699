"""Layer by layer: each of torch's submodules against ours, and why the first that differs does.

A layer `alone` is ours on the input that torch's was given; any other row is our network's own
value at that place, from the scenes on. So a layer that differs alone computes something else, and
a place that differs although its layers agree alone was given something else.
"""

import itertools
from collections.abc import Mapping, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from neurosym_jax.interop.case import GeneratorCase
from neurosym_jax.interop.names import Layer, layers_of
from neurosym_jax.models import Generator
from neurosym_jax.models.decoder import pool
from neurosym_jax.models.layers import Affine, Perceptron
from neurosym_jax.models.lstm import LSTM

__all__ = ["ALONE", "compared_layers", "likely_reason"]

ALONE = " (alone)"
INPUT, STATE = "obs_traj_rel", "decoder, first state"
NO_RELU = frozenset({"Linear", "ReLU", "BatchNorm1d", "Dropout", "Sequential"})
"""Classes in a perceptron of SGAN's that are no other activation."""


def compared_layers(case: GeneratorCase) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """(ours, theirs) by row, in the order in which torch's submodules returned.

    A layer of the checkpoint that torch never called is compared with NaN.
    """
    layers = _layers(case)
    ours = _places(case)
    compared = {}
    first = case.arrays.get("in/encoder.spatial_embedding")
    if first is not None:
        compared[INPUT] = (ours[INPUT], first)
    for name in case.row["layers"]:
        if f"out/{name}" not in case.arrays:
            continue
        theirs = case.arrays[f"out/{name}"]
        if name in layers:
            compared[name + ALONE] = (_alone(case, layers[name]), theirs)
        if name in ours:
            compared[name] = (ours[name], theirs)
        if name == "mlp_decoder_context" or ("pool_net" not in ours and name == "encoder"):
            start = case.arrays.get("h0/decoder.decoder")
            if start is not None:
                compared[STATE] = (ours[STATE], start[0, : len(ours[STATE])])
    for name in layers.keys() - case.row["layers"].keys():
        compared[name + ALONE] = (np.zeros(1), np.full(1, np.nan))
    return compared


def likely_reason(case: GeneratorCase, row: str, ours: np.ndarray, theirs: np.ndarray) -> str:
    """Why the first row that differs does, `ours [...]` and `theirs [...]`."""
    name = row.removesuffix(ALONE)
    layers = _layers(case)
    if np.isnan(theirs).all():
        return "the checkpoint has it and the module never calls it"
    if theirs.shape != ours.shape:
        return f"its shape is {list(theirs.shape)}, ours {list(ours.shape)}"
    if row.endswith(ALONE):
        return _reason_alone(case, layers[name], ours, theirs)
    for decimals in range(1, 5):
        if np.abs(theirs - np.round(theirs, decimals)).max() < 1e-7 < np.abs(theirs).max():
            return f"it is rounded to {decimals} decimals, ours is not"
    if name == INPUT:
        return "the module changes its input before the first layer"
    others = _alternatives(case, name)
    for reason, other in others.items():
        if other.shape == theirs.shape and _near(other, theirs):
            return reason
    return "its layers agree alone: the module's forward puts them together in another way"


def _reason_alone(case: GeneratorCase, layer: Layer, ours: np.ndarray, theirs: np.ndarray) -> str:
    if layer.kind == "lstm":
        for changed, reason in _other_lstms(_params(case, layer)):
            if _near(_lstm(case.arrays, layer.torch, changed), theirs):
                return reason
        return f"its cell is a {case.row['layers'][layer.torch]} that is not torch's LSTM"
    within = layer.torch + "."
    classes = [kind for name, kind in case.row["layers"].items() if name.startswith(within)]
    for kind in classes:
        if kind not in NO_RELU:
            return f"activation {kind}, ours is ReLU"
    if layer.kind == "mlp" and _near(np.maximum(theirs, 0), ours):
        return "no ReLU after its last layer, ours has one"
    if layer.kind == "mlp" and classes.count("ReLU") < classes.count("Linear"):
        return "not every one of its layers is followed by a ReLU"
    if layer.kind == "dense" and _near(np.maximum(ours, 0), theirs):
        return "a ReLU after it, ours has none"
    return "it computes something else with the same weights"


def _layers(case: GeneratorCase) -> dict[str, Layer]:
    return {layer.torch: layer for layer in layers_of(case.config) if layer.ours}


def _params(case: GeneratorCase, layer: Layer) -> Any:
    node: Any = case.params
    for part in (layer.ours or "").split("/"):
        node = node[part]
    return node


def _places(case: GeneratorCase) -> dict[str, np.ndarray]:
    """Our values at the places that have a name in torch, [A, ...]."""
    stages = case.stages()
    moves = case.moves[:, : case.config.obs_len]
    stages[INPUT] = np.swapaxes(moves, 0, 1).reshape(-1, 2)
    stages[STATE] = np.concatenate(_state_parts(case, stages), axis=-1)
    return stages


def _state_parts(case: GeneratorCase, stages: Mapping[str, np.ndarray]) -> list[np.ndarray]:
    noise = case.noise()
    if noise.ndim == 2:
        noise = np.broadcast_to(noise[:, None], (*case.scenes.valid.shape, noise.shape[-1]))
    return [stages.get("mlp_decoder_context", stages["encoder"]), noise[case.scenes.valid]]


def _alone(case: GeneratorCase, layer: Layer) -> np.ndarray:
    """Our layer's output for the inputs that torch's was given."""
    params = _params(case, layer)
    if layer.kind == "lstm":
        return _lstm(case.arrays, layer.torch, params)
    network = Affine(*layer.sizes) if layer.kind == "dense" else Perceptron(layer.sizes)
    given = case.arrays[f"in/{layer.torch}"].astype(np.float32)
    return np.asarray(jax.jit(network.apply)({"params": params}, given))


def _lstm(arrays: Mapping[str, np.ndarray], name: str, params: Mapping[str, Any]) -> np.ndarray:
    cell = LSTM()
    steps = np.asarray(arrays[f"in/{name}"], np.float32)
    zeros = np.zeros((steps.shape[1], len(params["recurrent_kernel"])), np.float32)
    state = tuple(arrays.get(f"{part}/{name}", zeros[None])[0] for part in ("h0", "c0"))
    bias = params["input_bias"] + params["recurrent_bias"]
    hidden = []
    for step in steps:
        gates = step @ params["input_kernel"] + bias + state[0] @ params["recurrent_kernel"]
        state = cell.update(gates, state)
        hidden.append(np.asarray(state[0]))
    return np.stack(hidden)


def _other_lstms(params: Mapping[str, Any]) -> Sequence[tuple[dict[str, Any], str]]:
    """The LSTM with one bias, and with other orders of gates, and what torch's then does."""
    found = []
    for left_out in ("input_bias", "recurrent_bias"):
        name = {"input_bias": "bias_ih_l0", "recurrent_bias": "bias_hh_l0"}[left_out]
        without = {**params, left_out: 0 * params[left_out]}
        found.append((without, f"it has one bias and not two: {name} is left out"))
    for order in itertools.permutations(range(4)):
        gates = {
            name: np.concatenate([np.split(array, 4, axis=-1)[gate] for gate in order], axis=-1)
            for name, array in params.items()
        }
        letters = ", ".join("ifgo"[order.index(gate)] for gate in range(4))
        found.append((gates, f"its gates are in the order {letters}, ours i, f, g, o"))
    return found


def _alternatives(case: GeneratorCase, name: str) -> dict[str, np.ndarray]:
    """By the reason, what the place `name` would be in a module that differs for that reason."""
    stages = case.stages()
    if name == STATE:
        context, noise = _state_parts(case, stages)
        return {
            "noise before the context, ours after it": np.concatenate([noise, context], axis=-1),
            "the noise is left out, or is not the one given": np.concatenate(
                [context, 0 * noise], axis=-1
            ),
        }
    if name == "pool_net":
        several = "scene boundaries: it pools over all scenes together"
        return {several: _pooled_together(case, stages["encoder"])}
    if name == "mlp_decoder_context" and "pool_net" in stages:
        parts = [stages["pool_net"], stages["encoder"]]
        swapped = np.concatenate(parts, axis=-1)
        layer = _layers(case)[name]
        network = Perceptron(layer.sizes)
        return {
            "the pooled vector before the hidden state, ours after it": np.asarray(
                network.apply({"params": _params(case, layer)}, swapped)
            )
        }
    return {}


def _pooled_together(case: GeneratorCase, hidden: np.ndarray) -> np.ndarray:
    track = case.windows.position[:, : case.config.obs_len].astype(np.float32)

    def of_all(network: Generator) -> Any:
        valid = np.ones(len(hidden), bool)
        given = (jnp.asarray(hidden), jnp.asarray(track), valid, None)
        return pool(network.pooling, case.config.pooling, *given)

    return np.asarray(Generator(case.config).apply({"params": case.params}, method=of_all))


def _near(a: np.ndarray, b: np.ndarray) -> bool:
    return bool(np.abs(a - b).max() < 1e-5)
