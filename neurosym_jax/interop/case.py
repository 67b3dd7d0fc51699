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
from neurosym_jax.forecasting.batched import unpacked
from neurosym_jax.interop.checkpoint import generator
from neurosym_jax.interop.names import torch_names
from neurosym_jax.models import Generator
from neurosym_jax.models.cell import LSTM, LSTMNetwork
from neurosym_jax.models.config import GeneratorConfig
from neurosym_jax.scene import Scene

__all__ = [
    "Arrays",
    "Case",
    "Compared",
    "compared_layers",
    "make_case",
    "padded",
    "placed",
    "read_case",
    "state_of",
]

Arrays = Mapping[str, np.ndarray]
Compared = dict[str, tuple[Any, np.ndarray]]
"""Per output, ours and theirs."""


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

    @property
    def noise(self) -> np.ndarray:
        """The stored noise of each agent, [A, D]."""
        noise = self.arrays["noise"][:, : self.config.noise_dim]
        per_agent = self.config.noise_mix_type == "ped"
        return noise if per_agent else np.repeat(noise, np.diff(self.bounds), axis=0)

    def stages(self, alpha: np.ndarray | None = None) -> dict[str, np.ndarray]:
        """Our forecast [A, pred_len, 2] and the vectors [A, ...] before it, by torch's names."""
        given = self.scenes.bare(), placed(self.noise, self.valid), alpha
        found = _stages(self.config, self.params, *given)
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
    """The case of a manifest's row and of its arrays [...], among them the weights."""
    return make_case(*generator(row, state_of(arrays, weights)), arrays)


def make_case(config: GeneratorConfig, params: dict[str, Any], arrays: Arrays) -> Case:
    """The case of our network and of torch's arrays [...]."""
    bounds = np.append(0, arrays["scene_start_end"][:, 1])
    scenes = padded(arrays["traj"], arrays["traj_rel"], bounds, config.obs_len)
    return Case(arrays, config, params, bounds, scenes)


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
    value at that place, from the scenes on. A layer that torch never called is compared with NaN.
    """
    arrays, stages, layers = case.arrays, case.stages(), _layers(case)
    context = "mlp_decoder_context" if case.config.needs_context_mlp else "encoder"
    start = np.concatenate([stages[context], case.noise], axis=-1)
    compared: Compared = {}
    if "in/encoder.spatial_embedding" in arrays:
        moves = np.swapaxes(arrays["traj_rel"][:, : case.config.obs_len], 0, 1).reshape(-1, 2)
        compared["obs_traj_rel"] = moves, arrays["in/encoder.spatial_embedding"]
    for name in names:
        theirs = arrays[f"out/{name}"]
        if name in layers:
            compared[f"{name} (alone)"] = _alone(arrays, name, layers[name]), theirs
        if name in stages:
            compared[name] = stages[name], theirs
        if name == context and "h0/decoder.decoder" in arrays:
            compared["decoder, first state"] = start, arrays["h0/decoder.decoder"][0]
    for name in layers.keys() - names.keys():
        compared[f"{name} (alone)"] = np.zeros(1), np.full(1, np.nan)
    return compared


def _layers(case: Case) -> dict[str, Any]:
    """Our layers and perceptrons, by torch's names."""
    network, found = Generator(case.config).bind({"params": case.params}), {}
    for name, (path, _) in torch_names(case.config).items():
        *parts, _ = re.sub(r"/layer_\d", "", path).replace("lstm", "recurrent").split("/")
        found[re.sub(r"(\.\d)?\.\w+$", "", name)] = functools.reduce(getattr, parts, network)
    return found


def _alone(arrays: Arrays, name: str, layer: Any) -> np.ndarray:
    """Our layer's output for the inputs that torch's was given."""
    given = arrays[f"in/{name}"].astype(np.float32)
    if not isinstance(layer, LSTMNetwork):
        return np.asarray(layer(given))
    zeros = np.zeros((1, given.shape[1], layer.features), np.float32)
    state = tuple(arrays.get(f"{part}/{name}", zeros)[0] for part in ("h0", "c0"))
    hidden = []
    for step in given:
        state = LSTM().update(layer(step) + state[0] @ layer.recurrent_kernel, state)
        hidden.append(np.asarray(state[0]))
    return np.stack(hidden)
