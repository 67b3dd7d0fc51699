"""Kinds of parity cases: outputs that torch stored, and ours of the same inputs.

A kind is a function of a manifest row and the case's arrays that returns `{output: (ours,
theirs)}`; `CASES` has them by name.
"""

import dataclasses
import functools
from collections.abc import Callable, Mapping
from typing import Any

import jax
import numpy as np
import optax
from jax.flatten_util import ravel_pytree

from neurosym_jax.interop.case import Arrays, Case, Compared, padded, placed, read_case, state_of
from neurosym_jax.interop.checkpoint import discriminator
from neurosym_jax.interop.names import params_from_torch
from neurosym_jax.models import Discriminator, NeurosymIjcnn
from neurosym_jax.models.config import DiscriminatorConfig, GeneratorConfig
from neurosym_jax.scene import Scene
from neurosym_jax.symbolic.cnd import alpha_from_states
from neurosym_jax.symbolic.qtc import observe
from neurosym_jax.symbolic.weightings import CndShipped, make_weighting
from neurosym_jax.training.gradients import discriminator_gradient, generator_gradient
from neurosym_jax.training.recipe import RECIPES
from neurosym_jax.training.step import clipping, new_state, update, update_discriminator
from neurosym_jax.training.stream import Groups

__all__ = ["CASES", "forecasts"]

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
    """The generator's forecast and, with `d_type`, the discriminator's scores.

    The discriminator sees torch's forecast, not ours, so that a fault of the generator is not
    reported twice.
    """
    case = read_case(row, arrays)
    compared = forecasts(case)
    if "d_type" in row:
        config, params = discriminator(row, state_of(arrays, "d_state/"))
        positions, moves = (
            np.concatenate([arrays[seen][:, : case.config.obs_len], arrays[forecast]], axis=1)
            for seen, forecast in (("traj", "pred_abs"), ("traj_rel", "pred_rel"))
        )
        fakes = padded(positions, moves, case.bounds, positions.shape[1])
        scores = np.asarray(_scores(config, params, fakes.bare()))[case.valid]
        compared["d_scores_fake"] = scores, arrays["d_scores_fake"]
    return compared


def forecasts(case: Case) -> Compared:
    """The generator's displacements, and positions in the frame of `traj`."""
    scenes, moves = case.scenes, case.stages()["pred_rel"]
    origin = np.repeat(np.asarray(scenes.origin), np.diff(case.bounds), axis=0)[:, None]
    last = np.asarray(scenes.observed)[case.valid][:, -1:]
    ours = {"pred_rel": moves, "pred_abs": last + np.cumsum(moves, axis=1) + origin}
    return {name: (each, case.arrays[name]) for name, each in ours.items()}


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
    pairs = valid[:, :, None] & valid[:, None]
    if isinstance(case.config.pooling, NeurosymIjcnn):
        alpha, pairs = alpha[: case.bounds[-1]], valid
        compared["alpha_rows_used"] = alpha, arrays["alpha_rows_used"]
    moves = case.stages(placed(alpha, pairs))["pred_rel"]
    return compared | {"pred_rel": (moves, arrays["pred_rel"])}


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
    critic, start = discriminator(row, state_of(arrays, "d0/"))
    recipe = dataclasses.replace(
        RECIPES["sgan"],
        best_k=row["best_k"],
        learning_rate=row["g_learning_rate"],
        d_learning_rate=row["d_learning_rate"],
        clip_norm=row["clipping_threshold_g"],
        # Numbers in the manifest, ranges with us.
        label_real=(row["label_real"], row["label_real"]),
        label_fake=(row["label_fake"], row["label_fake"]),
        discriminator=critic,
    )
    trees, metrics = _two_steps(
        case.config,
        recipe,
        {"params": case.params},
        {"params": start},
        (case.scenes.replace(origin=None),),  # One group, `[scenes, slots, ...]`.
        ([arrays["noise_d"][None]], [arrays["noise_g"]]),
    )
    compared: Compared = {n: (metrics[of], arrays[n]) for n, of in LOSSES.items()}
    for name, tree in trees.items():
        network = case.config if name.startswith("g") else critic
        theirs = {"params": params_from_torch(state_of(arrays, f"{name}/"), network)}
        compared[name] = ravel_pytree(tree)[0], np.asarray(ravel_pytree(theirs)[0])
    return compared


@functools.partial(jax.jit, static_argnums=(0, 1))
def _two_steps(
    config: GeneratorConfig, recipe: Any, params: Any, critic: Any, groups: Groups, noises: Any
):
    """Gradients and parameters after, by the names they are stored under, and metrics."""
    labels = {"label_real": recipe.label_real[0], "label_fake": recipe.label_fake[0]}
    state = new_state(recipe, params)._replace(
        discriminator=critic,
        discriminator_optimizer=optax.adam(recipe.d_learning_rate).init(critic),
    )
    d_gradient, d_metrics = discriminator_gradient(
        config, recipe, params, critic, groups, noises[0], **labels
    )
    state = update_discriminator(recipe, state, d_gradient)
    g_gradient, g_metrics = generator_gradient(
        config, recipe, params, state.discriminator, groups, noises[1], label=recipe.label_real[0]
    )
    state = update(recipe, state, g_gradient)
    ours = {
        "d_grad": d_gradient,
        "d1": state.discriminator,
        "g_grad_clipped": clipping(recipe).update(g_gradient, optax.EmptyState())[0],
        "g1": state.params,
    }
    return ours, d_metrics | g_metrics


CASES: dict[str, Callable[[Mapping[str, Any], Arrays], Compared]] = {
    "sgan": sgan,
    "neurosym": neurosym,
    "qtc": qtc,
    "train_step": train_step,
}
