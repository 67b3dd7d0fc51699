"""Parity cases: inputs, weights and outputs that torch stored, and our outputs of the same.

A kind of case is a function of a manifest row and the case's arrays that returns
`{output: (ours, theirs)}`; `CASES` has them by name.
"""

import dataclasses
import functools
from collections.abc import Callable, Mapping
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from neurosym_jax.data.windows import Windows, gather_scenes
from neurosym_jax.interop.checkpoint import discriminator, generator
from neurosym_jax.models.forecast import unpacked
from neurosym_jax.models.sgan.network import (
    Discriminator,
    Generator,
    GeneratorConfig,
    NeurosymIjcnn,
)
from neurosym_jax.scene import Scene
from neurosym_jax.symbolic.weighting import CndShipped, make_weighting

__all__ = ["CASES", "Case", "Compared", "forecasts", "make_case", "read_case"]

Arrays = Mapping[str, np.ndarray]
Compared = dict[str, tuple[Any, np.ndarray]]
"""Per output, ours and theirs."""

DECIMALS = 4
"""Decimals of the authors' table as printed, and of their coordinates."""
RELEASED = CndShipped(convention="as_published", decimals=DECIMALS)


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
        is_global = self.config.noise_mix_type == "global"
        if is_global:
            return np.repeat(noise, np.diff(self.bounds), axis=0)
        return noise

    @property
    def alpha(self) -> np.ndarray | None:
        """The stored weights in our places, see `placed_alpha`."""
        if "alpha" not in self.arrays:
            return None
        return placed_alpha(self.arrays["alpha"], self.valid, self.config)

    def stages(self) -> dict[str, np.ndarray]:
        """Our forecast [A, pred_len, 2] and the vectors [A, ...] before it, by torch's names."""
        noise = placed(self.noise, self.valid)
        scenes = self.scenes.bare()
        values = _stages(self.config, self.params, scenes, noise, self.alpha)
        return jax.tree.map(lambda leaf: np.asarray(leaf)[self.valid], values)


@functools.partial(jax.jit, static_argnums=0)
def _stages(
    config: GeneratorConfig, params: Any, *scene_arrays: Any
) -> dict[str, Array]:
    """[S, N, ...] by torch's names; one scene after another, so memory is that of one."""

    def scene_stages(
        network: Generator, scene: Scene, noise: Array, alpha: Array | None
    ) -> Any:
        hidden = network.observe(jnp.asarray(scene.displacement))
        context = network.interact(hidden, scene, alpha)
        stages = {"encoder": hidden, "mlp_decoder_context": context}
        if config.pools:
            name = "pool_net_g" if weights_pairs(config) else "pool_net"
            stages[name] = network.pool(hidden, scene, alpha)
        stages["pred_rel"] = network.decode(context, scene, noise)
        return stages

    def apply(arrays: Any) -> Any:
        return Generator(config).apply({"params": params}, *arrays, method=scene_stages)

    return jax.lax.map(apply, scene_arrays)


def read_case(
    row: Mapping[str, Any], arrays: Arrays, weights: str = "g_state/"
) -> Case:
    """The case of a manifest's row and of its arrays [...], among them the weights."""
    config, params = generator(row, state_of(arrays, weights))
    return make_case(config, params, arrays)


def make_case(config: GeneratorConfig, params: dict[str, Any], arrays: Arrays) -> Case:
    """The case of our network and of torch's arrays [...]."""
    bounds = np.append(0, arrays["scene_start_end"][:, 1])
    scenes = padded(arrays["traj"], arrays["traj_rel"], bounds, config.obs_len)
    return Case(arrays, config, params, bounds, scenes)


def state_of(arrays: Arrays, prefix: str) -> dict[str, np.ndarray]:
    """The state dict that is stored under `prefix`."""
    state = {}
    for name, array in arrays.items():
        if name.startswith(prefix):
            state[name.removeprefix(prefix)] = array
    return state


def placed(values: np.ndarray, mask: np.ndarray) -> np.ndarray:
    """`values [A, ...]` in the A places `mask [S, ...]` (bool) of zeros: `[S, ..., ...]`."""
    return unpacked(values[None], mask)[0]


def weights_pairs(config: GeneratorConfig) -> bool:
    """Whether the generator is of one of NeuroSyM's releases, also of the first."""
    return not config.pooling.inputs.isdisjoint({"alpha", "alpha_rows"})


def placed_alpha(
    alpha: np.ndarray, valid: np.ndarray, config: GeneratorConfig
) -> np.ndarray:
    """Weights `alpha [P, T]` of pairs in the places of `valid [S, N]`: [S, N, N, T].

    They are rows [S, N, T] for the first release, whose A agents read the first A rows,
    see `neurosym`.
    """
    if isinstance(config.pooling, NeurosymIjcnn):
        return placed(alpha[: valid.sum()], valid)
    return placed(alpha, valid[:, :, None] & valid[:, None])


def padded(
    positions: np.ndarray, moves: np.ndarray, bounds: np.ndarray, obs_len: int
) -> Scene:
    """Scenes [S, N, ...] of `positions [A, T, 2]`, centred, and of `moves [A, T, 2]` as given."""
    agents = np.arange(len(positions))
    identity = np.zeros((len(bounds) - 1, 2), np.uint32)
    windows = Windows(positions.astype(np.float64), agents, bounds, identity, obs_len)
    slots = int(windows.sizes.max())
    scenes = gather_scenes(windows, np.arange(windows.scenes), slots)
    observed_moves = moves[:, :obs_len].astype(scenes.observed.dtype)
    steps = placed(observed_moves, np.asarray(scenes.valid))
    return scenes.replace(displacement=steps, identity=None)


def sgan(row: Mapping[str, Any], arrays: Arrays) -> Compared:
    """The generator's forecast and, with `d_type`, the discriminator's scores.

    The discriminator sees torch's forecast, not ours, so that a fault of the generator
    is not reported twice.
    """
    case = read_case(row, arrays)
    compared = forecasts(case)
    if "d_type" not in row:
        return compared
    config, params = discriminator(row, state_of(arrays, "d_state/"))
    tracks = []
    for seen, forecast in (("traj", "pred_abs"), ("traj_rel", "pred_rel")):
        observed = arrays[seen][:, : case.config.obs_len]
        tracks.append(np.concatenate([observed, arrays[forecast]], axis=1))
    positions, moves = tracks
    fakes = padded(positions, moves, case.bounds, positions.shape[1])

    def score(scene: Scene) -> Any:
        inputs = scene.observed, scene.displacement, scene.valid
        return Discriminator(config).apply({"params": params}, *inputs)

    scores = np.asarray(jax.lax.map(score, fakes.bare()))
    compared["d_scores_fake"] = scores[case.valid], arrays["d_scores_fake"]
    return compared


def forecasts(case: Case) -> Compared:
    """The generator's displacements, and positions in the frame of `traj`."""
    moves = case.stages()["pred_rel"]
    sizes = np.diff(case.bounds)
    origin = np.repeat(np.asarray(case.scenes.origin), sizes, axis=0)
    observed = np.asarray(case.scenes.observed)[case.valid]
    ahead = np.cumsum(moves, axis=1)
    positions = observed[:, -1:] + ahead + origin[:, None]
    return {
        "pred_rel": (moves, case.arrays["pred_rel"]),
        "pred_abs": (positions, case.arrays["pred_abs"]),
    }


def neurosym(row: Mapping[str, Any], arrays: Arrays) -> Compared:
    """The forecast, given the stored alpha; and alpha itself, unless the row calls it random.

    NeuroSyM's first release stores a row of alpha for each ordered pair, N*N for a
    scene of N agents, but slices the rows by the agents' bounds. So a scene gets rows
    of other pairs, after the first scene those of other scenes, and its network reads
    row start + j for agent j, for every i: the A agents get the first A rows, which are
    compared as well.
    """
    case = read_case(row, arrays)
    alpha = arrays["alpha"]
    compared: Compared = {}
    if row.get("alpha") != "random":
        # Stored as float32, but the released code observed its symbols in float64.
        seen = arrays["traj"][:, : case.config.obs_len]
        seen = seen.astype(np.float64).round(DECIMALS)
        weigh = jax.jit(make_weighting(RELEASED))
        pairs = []
        with jax.enable_x64(True):
            for scene in np.split(seen, case.bounds[1:-1]):
                weights = np.asarray(weigh(scene))
                pairs.append(weights.reshape(-1, weights.shape[-1]))
        # [sum of N*N, T]: a scene of one agent has one row, of zeros.
        compared["alpha"] = np.concatenate(pairs), alpha
    if "alpha_rows_used" in arrays:
        rows = alpha[: case.bounds[-1]]
        compared["alpha_rows_used"] = rows, arrays["alpha_rows_used"]
    moves = case.stages()["pred_rel"]
    return compared | {"pred_rel": (moves, arrays["pred_rel"])}


CASES: dict[str, Callable[[Mapping[str, Any], Arrays], Compared]] = {
    kind.__name__: kind for kind in (sgan, neurosym)
}
