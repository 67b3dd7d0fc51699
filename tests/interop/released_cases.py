"""Kinds of parity cases that only the stored outputs of the released code have."""

import dataclasses
from collections.abc import Mapping
from typing import Any

import jax
import numpy as np
import optax
from jax.flatten_util import ravel_pytree

from neurosym_jax.interop.cases import (
    CASES,
    RELEASED,
    Arrays,
    Compared,
    read_case,
    state_of,
)
from neurosym_jax.interop.checkpoint import discriminator
from neurosym_jax.models.sgan.torch_names import params_from_torch
from neurosym_jax.models.sgan.training import RECIPES, init_adversary, learn
from neurosym_jax.symbolic.qtc import encode_state, observe
from neurosym_jax.training.state import clipping, new_state

LOSSES = {
    "d_loss": "d_loss",
    "g_l2_loss": "g_variety",
    "g_adv_loss": "g_adversarial",
    "g_grad_norm": "g_gradient_norm",
}
"""Names of the stored scalars, and of our metrics."""


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
    compared: Compared = {}
    for name, array in values.items():
        stored = arrays[name]
        compared[name] = array, np.where(stored == 10, 0, stored)
    return compared


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
    adversary = init_adversary(recipe, {"params": start})
    before = new_state(recipe, {"params": case.params}, adversary)
    step = jax.jit(learn, static_argnums=(0, 1))
    state, metrics, (d_gradient, g_gradient) = step(
        case.config,
        recipe,
        before,
        (batch, [arrays["noise_d"][None]]),
        (batch, [arrays["noise_g"]]),
        real=(row["label_real"], row["label_real"]),
        fake=row["label_fake"],
    )
    clipped, _ = clipping(recipe).update(g_gradient, optax.EmptyState())
    compared: Compared = {}
    for name, metric in LOSSES.items():
        compared[name] = metrics[metric], arrays[name]
    trees = {
        "d_grad": (critic, d_gradient),
        "d1": (critic, state.extra.params),
        "g_grad_clipped": (case.config, clipped),
        "g1": (case.config, state.params),
    }
    for name, (network, tree) in trees.items():
        torch_params = params_from_torch(state_of(arrays, f"{name}/"), network)
        vector, _ = ravel_pytree(tree)
        torch_vector, _ = ravel_pytree({"params": torch_params})
        compared[name] = vector, np.asarray(torch_vector)
    return compared


CASES |= {"qtc": qtc, "train_step": train_step}
