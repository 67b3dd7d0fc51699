"""A parity case: torch's weights, scenes and layers, and what our networks make of them."""

import dataclasses
import functools
import re
from collections.abc import Mapping
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from neurosym_jax.data.batching import gather_scenes
from neurosym_jax.data.windows import Windows
from neurosym_jax.errors import InputError
from neurosym_jax.forecasting.batched import unpacked
from neurosym_jax.interop.arguments import generator_config
from neurosym_jax.interop.names import params_from_torch, torch_names
from neurosym_jax.models import Generator
from neurosym_jax.models.cell import LSTM
from neurosym_jax.models.config import GeneratorConfig
from neurosym_jax.models.layers import Affine, Perceptron
from neurosym_jax.scene import Scene, model_dtype

__all__ = [
    "Arrays",
    "Case",
    "Compared",
    "checked",
    "compared_layers",
    "padded",
    "placed",
    "read_case",
    "state_of",
]

Arrays = Mapping[str, np.ndarray]
Compared = dict[str, tuple[Any, np.ndarray]]
"""Per output, ours and theirs, of one shape."""


@dataclasses.dataclass(frozen=True, eq=False)
class Case:
    """A generator of torch in our terms, and A agents in S scenes."""

    arrays: Arrays
    config: GeneratorConfig
    params: dict[str, Any]
    bounds: np.ndarray
    """[S + 1]; scene s holds the agents `bounds[s]:bounds[s + 1]`."""
    scenes: Scene
    """Padded to one size, [S, N, ...], with the displacements that torch was given."""

    @property
    def valid(self) -> np.ndarray:
        """[S, N]; A are true."""
        return np.asarray(self.scenes.valid)

    def noise(self) -> np.ndarray:
        """The stored noise of each slot, [S, N, D]."""
        config, shape = self.config, self.valid.shape
        if config.noise_dim == 0:
            return np.zeros((*shape, 0), model_dtype())
        if config.noise_mix_type == "ped":
            noise = checked(self.arrays, "noise", self.bounds[-1], config.noise_dim)
            return placed(noise, self.valid)
        noise = checked(self.arrays, "noise", len(self.valid), config.noise_dim)
        return np.broadcast_to(noise[:, None], (*shape, config.noise_dim))

    def stages(self, alpha: np.ndarray | None = None) -> dict[str, np.ndarray]:
        """Our forecast [A, pred_len, 2] and the vectors [A, ...] before it, by torch's names."""
        found = _stages(self.config, self.params, self.scenes.bare(), self.noise(), alpha)
        return {name: np.asarray(each)[self.valid] for name, each in found.items()}


@functools.partial(jax.jit, static_argnums=0)
def _stages(config: GeneratorConfig, params: Any, *given: Any) -> dict[str, Array]:
    """[S, N, ...] by torch's names; one scene after another, so memory is that of one."""

    def of_scene(network: Generator, scene: Scene, noise: Array, alpha: Array | None) -> Any:
        hidden = network.observe(jnp.asarray(scene.displacement))
        context = network.interact(hidden, scene, alpha)
        found = {"encoder": hidden, "pred_rel": network.decode(context, scene, noise)}
        if config.pools:
            found["pool_net"] = network.pool(hidden, scene, alpha)
        if config.needs_context_mlp:
            found["mlp_decoder_context"] = context
        return found

    every = functools.partial(Generator(config).apply, {"params": params}, method=of_scene)
    return jax.lax.map(lambda scene: every(*scene), given)


def read_case(row: Mapping[str, Any], arrays: Arrays, weights: str = "g_state/") -> Case:
    """The case of a manifest's row and of its arrays, among them the weights.

    Raises:
        InputError: for an argument or an array that is missing or wrong.
    """
    state = state_of(arrays, weights)
    config = generator_config(row, state)
    positions = checked(arrays, "traj", None, config.obs_len + config.pred_len, 2)
    moves = checked(arrays, "traj_rel", *positions.shape)
    starts, ends = checked(arrays, "scene_start_end", None, 2).astype(np.int64).T
    bounds = np.append(0, ends)
    if (starts != bounds[:-1]).any() or (ends <= starts).any() or bounds[-1] != len(positions):
        raise InputError(
            f"'scene_start_end' does not cut {len(positions)} agents into scenes one after another"
        )
    scenes = padded(positions, moves, bounds, config.obs_len)
    return Case(arrays, config, params_from_torch(state, config), bounds, scenes)


def checked(arrays: Arrays, name: str, *shape: int | None) -> np.ndarray:
    """The finite array `name` of this shape; None is any size.

    Raises:
        InputError: naming the array and what is wrong with it.
    """
    if name not in arrays:
        raise InputError(f"the array {name!r} is missing")
    array = arrays[name]
    if array.ndim != len(shape) or any(b not in (None, a) for a, b in zip(array.shape, shape)):
        wanted = ", ".join("any" if size is None else str(size) for size in shape)
        raise InputError(f"{name!r} has the shape {list(array.shape)}, not [{wanted}]")
    if array.dtype.kind not in "fiu" or not np.isfinite(array).all():
        raise InputError(f"{name!r} holds a value that is not a finite number")
    return array


def state_of(arrays: Arrays, prefix: str) -> dict[str, np.ndarray]:
    """The state dict that is stored under `prefix`."""
    return {k.removeprefix(prefix): array for k, array in arrays.items() if k.startswith(prefix)}


def placed(values: np.ndarray, there: np.ndarray) -> np.ndarray:
    """`values [A, ...]` in the A places `there [S, ...]` (bool) of zeros: `[S, ..., ...]`."""
    return unpacked(values[None], there)[0]


def padded(positions: np.ndarray, moves: np.ndarray, bounds: np.ndarray, obs_len: int) -> Scene:
    """Scenes [S, N, ...] of `positions [A, T, 2]`, centred, and of `moves [A, T, 2]` as given."""
    position = positions.astype(np.float64)
    identity = np.zeros((len(bounds) - 1, 2), np.uint32)
    windows = Windows(position, np.arange(len(position)), bounds, identity, obs_len)
    scenes = gather_scenes(windows, np.arange(windows.scenes), int(windows.sizes.max()))
    given = placed(moves[:, :obs_len].astype(scenes.observed.dtype), np.asarray(scenes.valid))
    return scenes.replace(displacement=given, identity=None)


def compared_layers(case: Case, names: Mapping[str, str]) -> Compared:
    """(ours, theirs) by row, for torch's submodules `names` in the order in which they returned.

    A layer `alone` is ours on the input that torch's was given; any other row is our network's own
    value at that place, from the scenes on. So a layer that differs alone computes something else,
    and a place that differs although its layers agree alone was given something else. A layer of
    the checkpoint that torch never called is compared with NaN.
    """
    arrays, stages = case.arrays, case.stages()
    moves = arrays["traj_rel"][:, : case.config.obs_len]
    context = "mlp_decoder_context" if case.config.needs_context_mlp else "encoder"
    state = np.concatenate([stages[context], case.noise()[case.valid]], axis=-1)
    layers, compared = _layers(case), {}
    if (first := arrays.get("in/encoder.spatial_embedding")) is not None:
        compared["obs_traj_rel"] = np.swapaxes(moves, 0, 1).reshape(-1, 2), first
    for name in names:
        theirs = arrays[f"out/{name}"]
        if name in layers:
            compared[f"{name} (alone)"] = _alone(arrays, name, layers[name]), theirs
        if name in stages:
            compared[name] = stages[name], theirs
        if name == context and (start := arrays.get("h0/decoder.decoder")) is not None:
            compared["decoder, first state"] = state, start[0]
    for name in layers.keys() - names.keys():
        compared[f"{name} (alone)"] = np.zeros(1), np.full(1, np.nan)
    return compared


def _layers(case: Case) -> dict[str, Any]:
    """Parameters of our layers and perceptrons, by torch's names."""
    found = {}
    for name, (path, _) in torch_names(case.config).items():
        node: Any = case.params
        for part in re.sub(r"(/layer_\d)?/\w+$", "", path).split("/"):
            node = node[part]
        found[re.sub(r"(\.\d)?\.\w+$", "", name)] = node
    return found


def _alone(arrays: Arrays, name: str, params: Mapping[str, Any]) -> np.ndarray:
    """Our layer's output for the inputs that torch's was given."""
    given = np.asarray(arrays[f"in/{name}"], np.float32)
    if "recurrent_kernel" in params:
        zeros = np.zeros((1, given.shape[1], len(params["recurrent_kernel"])), np.float32)
        state = tuple(arrays.get(f"{part}/{name}", zeros)[0] for part in ("h0", "c0"))
        bias = params["input_bias"] + params["recurrent_bias"]
        hidden = []
        for step in given:
            gates = step @ params["input_kernel"] + bias + state[0] @ params["recurrent_kernel"]
            state = LSTM().update(gates, state)
            hidden.append(np.asarray(state[0]))
        return np.stack(hidden)
    kernels = [layer["kernel"] for layer in params.values()] if "layer_0" in params else []
    sizes = [*(kernel.shape[0] for kernel in kernels), *(k.shape[1] for k in kernels[-1:])]
    network = Perceptron(sizes) if kernels else Affine(*params["kernel"].shape)
    return np.asarray(network.apply({"params": params}, given))
