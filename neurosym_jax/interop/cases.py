"""Kinds of parity cases: outputs that torch stored, and ours of the same inputs.

A kind is a function of a manifest row and the case's arrays that returns `{output: (ours,
theirs)}`; `CASES` has them by name.
"""

import functools
from collections.abc import Callable, Mapping
from typing import Any

import jax
import numpy as np
import optax
from jax.flatten_util import ravel_pytree

from neurosym_jax.interop.arguments import discriminator_config
from neurosym_jax.interop.case import (
    Arrays,
    Case,
    Compared,
    padded,
    placed,
    read_case,
    state_of,
)
from neurosym_jax.interop.names import params_from_torch
from neurosym_jax.models import Discriminator, NeurosymIjcnn
from neurosym_jax.models.config import DiscriminatorConfig, GeneratorConfig
from neurosym_jax.scene import Scene
from neurosym_jax.symbolic.cnd import alpha_from_states
from neurosym_jax.symbolic.qtc import observe
from neurosym_jax.symbolic.state_weightings import CndShipped
from neurosym_jax.symbolic.weightings import make_weighting
from neurosym_jax.training.gradients import discriminator_gradient, generator_gradient
from neurosym_jax.training.groups import Groups
from neurosym_jax.training.recipe import TrainConfig
from neurosym_jax.training.step import (
    TrainState,
    clipping,
    initial_state,
    update,
    update_discriminator,
)

__all__ = ["CASES"]

DECIMALS = 4
"""Of the authors' table as they printed it, and of their coordinates."""
RELEASED = CndShipped(convention="as_published", decimals=DECIMALS)
LOSSES = {
    "d_loss": "d_loss",
    "g_l2_loss": "g_variety",
    "g_adv_loss": "g_adversarial",
    "g_grad_norm": "g_gradient_norm",
}
"""Names of the stored scalars, and of our metrics."""


def sgan(row: Mapping[str, Any], arrays: Arrays) -> Compared:
    """The generator's displacements and positions and, with `d_type`, the discriminator's scores.

    The discriminator sees torch's forecast, not ours, so that a fault of the generator is not
    reported twice.
    """
    case = read_case(row, arrays)
    obs_len, scenes = case.config.obs_len, case.scenes
    moves = case.stages()["pred_rel"]
    last = np.asarray(scenes.observed)[case.valid][:, -1:]
    origin = np.repeat(np.asarray(scenes.origin), np.diff(case.bounds), axis=0)[:, None]
    positions = last + np.cumsum(moves, axis=1) + origin
    pred_rel, pred_abs = arrays["pred_rel"], arrays["pred_abs"]
    compared: Compared = {"pred_rel": (moves, pred_rel), "pred_abs": (positions, pred_abs)}
    if "d_type" in row:
        state = state_of(arrays, "d_state/")
        config = discriminator_config(row, state)
        positions = np.concatenate([arrays["traj"][:, :obs_len], pred_abs], axis=1)
        moves = np.concatenate([arrays["traj_rel"][:, :obs_len], pred_rel], axis=1)
        fakes = padded(positions, moves, case.bounds, positions.shape[1])
        scores = _scores(config, params_from_torch(state, config), fakes.bare())
        compared["d_scores_fake"] = np.asarray(scores)[case.valid], arrays["d_scores_fake"]
    return compared


@functools.partial(jax.jit, static_argnums=0)
def _scores(config: DiscriminatorConfig, params: Any, scenes: Scene) -> Any:
    """[S, N] scores of whole trajectories, held by `scenes` as what was observed."""
    score = functools.partial(Discriminator(config).apply, {"params": params})
    return jax.lax.map(lambda s: score(s.observed, s.displacement, s.valid), scenes)


def neurosym(row: Mapping[str, Any], arrays: Arrays) -> Compared:
    """The forecast, given the stored alpha; and alpha itself, unless the row calls it random.

    NeuroSyM's first release stores a row of alpha for each ordered pair, N*N for a scene of N
    agents, but slices the rows by the agents' bounds. So a scene gets rows of other pairs, after
    the first scene those of other scenes, and its network reads row start + j for agent j, for
    every i: the A agents get the first A rows, which are compared as well.
    """
    case = read_case(row, arrays)
    alpha, valid = arrays["alpha"], case.valid
    compared: Compared = {}
    if row.get("alpha") != "random":
        compared["alpha"] = _shipped_alpha(case), alpha
    if isinstance(case.config.pooling, NeurosymIjcnn):
        used = alpha[: case.bounds[-1]]
        compared["alpha_rows_used"] = used, arrays["alpha_rows_used"]
        given = placed(used, valid)
    else:
        given = placed(alpha, valid[:, :, None] & valid[:, None])
    return compared | {"pred_rel": (case.stages(given)["pred_rel"], arrays["pred_rel"])}


def _shipped_alpha(case: Case) -> np.ndarray:
    """[sum of N*N, T] by the authors' table; a scene of one agent has one row, of zeros."""
    # Stored as float32, but the released code observed its symbols in float64.
    seen = case.arrays["traj"][:, : case.config.obs_len].astype(np.float64).round(DECIMALS)
    weigh = jax.jit(make_weighting(RELEASED))
    with jax.enable_x64(True):
        scenes = [np.asarray(weigh(part)) for part in np.split(seen, case.bounds[1:-1])]
    return np.concatenate([alpha.reshape(-1, alpha.shape[-1]) for alpha in scenes])


def qtc(_: Mapping[str, Any], arrays: Arrays) -> Compared:
    """States and weights of stored pairs, in every convention that is stored.

    Symbols are observed in float64 from the positions as stored, not centred: an exact tie, such as
    everybody on one line, is one in the coordinates that the released code saw. That code writes 10
    for a pair in which both people stand; we write 0.
    """
    k, l = (arrays[name].astype(np.float64) for name in "kl")  # noqa: E741 (as the calculus)
    with jax.enable_x64(True):
        compiled = jax.jit(observe, static_argnames="convention")
        released = compiled(k, l, convention="as_published")
        ours = {
            "qtc_reference": released,
            "qtc_signed": compiled(k, l),
            "qtc_signed_q005": compiled(k, l, quantisation_factor=0.05),
        }
        weights = np.asarray(alpha_from_states(released, RELEASED.state_weights()))
    compared: Compared = {"alpha_reference": (weights, arrays["alpha_reference"])}
    for name, states in ours.items():
        compared[name] = np.asarray(states), np.where(arrays[name] == 10, 0, arrays[name])
    return compared


def train_step(row: Mapping[str, Any], arrays: Arrays) -> Compared:
    """A discriminator step on one batch, then a generator step that the new discriminator scores.

    Noises, batch and the parameters before are torch's. Losses, gradients and the parameters after
    are compared, all parameters of a network as one vector.
    """
    case = read_case(row, arrays, "g0/")
    generator = case.config
    discriminator = discriminator_config(row, state_of(arrays, "d0/"))
    config = TrainConfig(
        best_k=row["best_k"],
        learning_rate=row["g_learning_rate"],
        d_learning_rate=row["d_learning_rate"],
        # Numbers in the manifest, ranges with us.
        label_real=(row["label_real"], row["label_real"]),
        label_fake=(row["label_fake"], row["label_fake"]),
        clip_norm=row["clipping_threshold_g"],
        adversarial_weight=1.0,
        criterion="squared_displacement",
        ema=0.0,
        schedule="constant",
        discriminator=discriminator,
    )
    # As one group, `[scenes, slots, ...]`.
    groups = (case.scenes.replace(origin=None),)
    noises = [arrays["noise_d"][None]], [arrays["noise_g"]]

    def stored(prefix: str) -> dict[str, Any]:
        network = generator if prefix.startswith("g") else discriminator
        return {"params": params_from_torch(state_of(arrays, prefix), network)}

    shapes = jax.eval_shape(lambda: initial_state(generator, config, jax.random.key(0)))
    # Adam's state is all zeros before its first step.
    state = jax.tree.map(lambda leaf: np.zeros(leaf.shape, leaf.dtype), shapes)
    state = state._replace(params=stored("g0/"), discriminator=stored("d0/"))
    trees, metrics = _two_steps(generator, config, state, groups, noises)
    compared: Compared = {n: (metrics[of], arrays[n]) for n, of in LOSSES.items()}
    for name, tree in trees.items():
        compared[name] = ravel_pytree(tree)[0], np.asarray(ravel_pytree(stored(f"{name}/"))[0])
    return compared


@functools.partial(jax.jit, static_argnums=(0, 1))
def _two_steps(
    generator: GeneratorConfig, config: TrainConfig, state: TrainState, groups: Groups, noises: Any
):
    """Gradients and parameters after, by the names they are stored under, and metrics."""
    real, fake = config.label_real[0], config.label_fake[0]
    batch = state.params, state.discriminator, groups, noises[0]
    labels = {"label_real": real, "label_fake": fake}
    d_gradient, d_metrics = discriminator_gradient(generator, config, *batch, **labels)
    state = update_discriminator(config, state, d_gradient)
    batch = state.params, state.discriminator, groups, noises[1]
    g_gradient, g_metrics = generator_gradient(generator, config, *batch, label=real)
    state = update(config, state, g_gradient)
    ours = {
        "d_grad": d_gradient,
        "d1": state.discriminator,
        "g_grad_clipped": clipping(config).update(g_gradient, optax.EmptyState())[0],
        "g1": state.params,
    }
    return ours, d_metrics | g_metrics


CASES: dict[str, Callable[[Mapping[str, Any], Arrays], Compared]] = {
    "sgan": sgan,
    "neurosym": neurosym,
    "qtc": qtc,
    "train_step": train_step,
}
