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
import optax
from jax import Array
from jax.flatten_util import ravel_pytree

from neurosym_jax.data.windows import Windows, gather_scenes
from neurosym_jax.interop.checkpoint import discriminator, generator
from neurosym_jax.models.forecast import unpacked
from neurosym_jax.models.sgan.network import Discriminator, Generator, GeneratorConfig
from neurosym_jax.models.sgan.pooling import NeurosymIjcnn
from neurosym_jax.models.sgan.torch_names import params_from_torch
from neurosym_jax.models.sgan.training import RECIPES, init_adversary, learn
from neurosym_jax.scene import Scene
from neurosym_jax.symbolic.qtc import encode_state, observe
from neurosym_jax.symbolic.weighting import CndShipped, make_weighting
from neurosym_jax.training.state import clipping, new_state

__all__ = ["CASES", "Case", "Compared", "forecasts", "make_case", "read_case"]

Arrays = Mapping[str, np.ndarray]
Compared = dict[str, tuple[Any, np.ndarray]]
"""Per output, ours and theirs."""

DECIMALS = 4
"""Decimals of the authors' table as printed, and of their coordinates."""
RELEASED = CndShipped(convention="as_published", decimals=DECIMALS)
LOSSES = {
    "d_loss": "d_loss",
    "g_l2_loss": "g_variety",
    "g_adv_loss": "g_adversarial",
    "g_grad_norm": "g_gradient_norm",
}
"""Names of the stored scalars, and of our metrics."""


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
        """The stored weights in our places: [S, N, N, T], or rows [S, N, T] of a release."""
        if "alpha" not in self.arrays:
            return None
        alpha, valid = self.arrays["alpha"], self.valid
        if isinstance(self.config.pooling, NeurosymIjcnn):
            # Its agents read the first A rows, see `neurosym`.
            return placed(alpha[: self.bounds[-1]], valid)
        return placed(alpha, valid[:, :, None] & valid[:, None])

    def stages(self) -> dict[str, np.ndarray]:
        """Our forecast [A, pred_len, 2] and the vectors [A, ...] before it, by torch's names."""
        noise = placed(self.noise, self.valid)
        scenes = self.scenes.bare()
        stages = _stages(self.config, self.params, scenes, noise, self.alpha)
        return {name: np.asarray(values)[self.valid] for name, values in stages.items()}


@functools.partial(jax.jit, static_argnums=0)
def _stages(
    config: GeneratorConfig, params: Any, *scene_arrays: Any
) -> dict[str, Array]:
    """[S, N, ...] by torch's names; one scene after another, so memory is that of one."""

    def of_scene(
        network: Generator, scene: Scene, noise: Array, alpha: Array | None
    ) -> Any:
        hidden = network.observe(jnp.asarray(scene.displacement))
        context = network.interact(hidden, scene, alpha)
        stages = {"encoder": hidden, "mlp_decoder_context": context}
        if config.pools:
            name = (
                "pool_net_g"
                if config.pooling.inputs & {"alpha", "alpha_rows"}
                else "pool_net"
            )
            stages[name] = network.pool(hidden, scene, alpha)
        return {**stages, "pred_rel": network.decode(context, scene, noise)}

    apply = functools.partial(
        Generator(config).apply, {"params": params}, method=of_scene
    )
    return jax.lax.map(lambda scene: apply(*scene), scene_arrays)


def read_case(
    row: Mapping[str, Any], arrays: Arrays, weights: str = "g_state/"
) -> Case:
    """The case of a manifest's row and of its arrays [...], among them the weights."""
    return make_case(*generator(row, state_of(arrays, weights)), arrays)


def make_case(config: GeneratorConfig, params: dict[str, Any], arrays: Arrays) -> Case:
    """The case of our network and of torch's arrays [...]."""
    bounds = np.append(0, arrays["scene_start_end"][:, 1])
    scenes = padded(arrays["traj"], arrays["traj_rel"], bounds, config.obs_len)
    return Case(arrays, config, params, bounds, scenes)


def state_of(arrays: Arrays, prefix: str) -> dict[str, np.ndarray]:
    """The state dict that is stored under `prefix`."""
    return {
        k.removeprefix(prefix): array
        for k, array in arrays.items()
        if k.startswith(prefix)
    }


def placed(values: np.ndarray, mask: np.ndarray) -> np.ndarray:
    """`values [A, ...]` in the A places `there [S, ...]` (bool) of zeros: `[S, ..., ...]`."""
    return unpacked(values[None], mask)[0]


def padded(
    positions: np.ndarray, moves: np.ndarray, bounds: np.ndarray, obs_len: int
) -> Scene:
    """Scenes [S, N, ...] of `positions [A, T, 2]`, centred, and of `moves [A, T, 2]` as given."""
    agents = np.arange(len(positions))
    identity = np.zeros((len(bounds) - 1, 2), np.uint32)
    windows = Windows(positions.astype(np.float64), agents, bounds, identity, obs_len)
    scenes = gather_scenes(windows, np.arange(windows.scenes), int(windows.sizes.max()))
    steps = placed(
        moves[:, :obs_len].astype(scenes.observed.dtype), np.asarray(scenes.valid)
    )
    return scenes.replace(displacement=steps, identity=None)


def sgan(row: Mapping[str, Any], arrays: Arrays) -> Compared:
    """The generator's forecast and, with `d_type`, the discriminator's scores.

    The discriminator sees torch's forecast, not ours, so that a fault of the generator
    is not reported twice.
    """
    case = read_case(row, arrays)
    compared = forecasts(case)
    if "d_type" in row:
        config, params = discriminator(row, state_of(arrays, "d_state/"))
        positions, moves = (
            np.concatenate(
                [arrays[seen][:, : case.config.obs_len], arrays[forecast]], axis=1
            )
            for seen, forecast in (("traj", "pred_abs"), ("traj_rel", "pred_rel"))
        )
        fakes = padded(positions, moves, case.bounds, positions.shape[1])
        score = functools.partial(Discriminator(config).apply, {"params": params})
        scores = jax.lax.map(
            lambda s: score(s.observed, s.displacement, s.valid), fakes.bare()
        )
        compared["d_scores_fake"] = (
            np.asarray(scores)[case.valid],
            arrays["d_scores_fake"],
        )
    return compared


def forecasts(case: Case) -> Compared:
    """The generator's displacements, and positions in the frame of `traj`."""
    scenes = case.scenes
    moves = case.stages()["pred_rel"]
    origin = np.repeat(np.asarray(scenes.origin), np.diff(case.bounds), axis=0)[:, None]
    last = np.asarray(scenes.observed)[case.valid][:, -1:]
    values = {"pred_rel": moves, "pred_abs": last + np.cumsum(moves, axis=1) + origin}
    return {name: (array, case.arrays[name]) for name, array in values.items()}


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
        seen = (
            arrays["traj"][:, : case.config.obs_len].astype(np.float64).round(DECIMALS)
        )
        weigh = jax.jit(make_weighting(RELEASED))
        with jax.enable_x64(True):
            scenes = [
                np.asarray(weigh(part)) for part in np.split(seen, case.bounds[1:-1])
            ]
        # [sum of N*N, T]: a scene of one agent has one row, of zeros.
        pairs = [weights.reshape(-1, weights.shape[-1]) for weights in scenes]
        compared["alpha"] = np.concatenate(pairs), alpha
    if "alpha_rows_used" in arrays:
        rows = alpha[: case.bounds[-1]]
        compared["alpha_rows_used"] = rows, arrays["alpha_rows_used"]
    moves = case.stages()["pred_rel"]
    return compared | {"pred_rel": (moves, arrays["pred_rel"])}


def qtc(_: Mapping[str, Any], arrays: Arrays) -> Compared:
    """States and weights of stored pairs, in every convention that is stored.

    Symbols are observed in float64 from the positions as stored, not centred: an exact
    tie, such as everybody on one line, is one in the coordinates that the released code
    saw. That code writes 10 for a pair in which both people stand; we write 0.
    """
    k, l = (arrays[name].astype(np.float64) for name in "kl")  # noqa: E741 (as the calculus)
    with jax.enable_x64(True):
        compiled = jax.jit(observe, static_argnames="convention")
        released = compiled(k, l, convention="as_published")
        values = {
            "alpha_reference": RELEASED.state_weights()[encode_state(released)],
            "qtc_reference": released,
            "qtc_signed": compiled(k, l),
            "qtc_signed_q005": compiled(k, l, quantisation_factor=0.05),
        }
    return {
        n: (array, np.where(arrays[n] == 10, 0, arrays[n]))
        for n, array in values.items()
    }


def train_step(row: Mapping[str, Any], arrays: Arrays) -> Compared:
    """A discriminator step on one batch, then a generator step that the new discriminator scores.

    Noises, batch and the parameters before are torch's. Losses, gradients and the
    parameters after are compared, all parameters of a network as one vector.
    """
    case = read_case(row, arrays, "g0/")
    critic, start = discriminator(row, state_of(arrays, "d0/"))
    recipe = dataclasses.replace(
        RECIPES["sgan"],
        best_k=row["best_k"],
        learning_rate=row["g_learning_rate"],
        d_learning_rate=row["d_learning_rate"],
        clip_norm=row["clipping_threshold_g"],
        discriminator=critic,
    )
    batch = (case.scenes.replace(origin=None),)  # One group, `[scenes, slots, ...]`.
    state, metrics, (d_gradient, g_gradient) = jax.jit(learn, static_argnums=(0, 1))(
        case.config,
        recipe,
        new_state(
            recipe, {"params": case.params}, init_adversary(recipe, {"params": start})
        ),
        (batch, [arrays["noise_d"][None]]),
        (batch, [arrays["noise_g"]]),
        real=(row["label_real"], row["label_real"]),
        fake=row["label_fake"],
    )
    clipped, _ = clipping(recipe).update(g_gradient, optax.EmptyState())
    trees = {"d_grad": d_gradient, "d1": state.extra.params}
    trees |= {"g_grad_clipped": clipped, "g1": state.params}
    compared: Compared = {
        n: (metrics[metric], arrays[n]) for n, metric in LOSSES.items()
    }
    for name, tree in trees.items():
        network = case.config if name.startswith("g") else critic
        torch_params = {
            "params": params_from_torch(state_of(arrays, f"{name}/"), network)
        }
        compared[name] = (
            ravel_pytree(tree)[0],
            np.asarray(ravel_pytree(torch_params)[0]),
        )
    return compared


CASES: dict[str, Callable[[Mapping[str, Any], Arrays], Compared]] = {
    kind.__name__: kind for kind in (sgan, neurosym, qtc, train_step)
}
