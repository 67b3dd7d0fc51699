"""Parity of one training step with a stored torch run: a case of `interop.cases`.

One discriminator step, then one generator step that the new discriminator scores, on one batch,
with given noises and no augmentation. The parameters before, the noises and the batch are torch's;
losses, gradients and the parameters after are compared, all parameters of a network as one vector.
"""

import dataclasses
import functools
from collections.abc import Mapping
from typing import Any

import jax
import numpy as np
from jax.flatten_util import ravel_pytree

from neurosym_jax.configuration import from_json
from neurosym_jax.errors import InputError
from neurosym_jax.interop.arguments import discriminator_config
from neurosym_jax.interop.case import Arrays, Compared, GeneratorCase, checked
from neurosym_jax.interop.names import params_from_torch
from neurosym_jax.models.config import GeneratorConfig
from neurosym_jax.training.gradients import discriminator_gradient, generator_gradient
from neurosym_jax.training.groups import Groups
from neurosym_jax.training.recipe import TrainConfig
from neurosym_jax.training.step import (
    TrainState,
    clip_gradient,
    initial_state,
    update_discriminator,
    update_generator,
)

__all__ = ["RECIPE", "train_step"]

RECIPE = {
    "label_real": "label_real",
    "label_fake": "label_fake",
    "g_learning_rate": "g_learning_rate",
    "d_learning_rate": "d_learning_rate",
    "best_k": "best_k",
    "l2_weight": "l2_loss_weight",
    "clip_norm": "clipping_threshold_g",
}
"""Our fields of a recipe, and what the manifest calls them."""

LOSSES = {
    "d_loss": "d_loss",
    "g_l2_loss": "g_variety",
    "g_adv_loss": "g_adversarial",
    "g_grad_norm": "g_gradient_norm",
}
"""Names of the stored scalars, and of our metrics."""


def train_step(row: Mapping[str, Any], arrays: Arrays) -> Compared:
    """(ours, theirs) of the losses, the gradients and the parameters after the two steps.

    Training is in float32, under x64 too.

    Raises:
        InputError: for a case that has not one noise a scene.
    """
    with jax.enable_x64(False):
        return _compared(row, arrays)


def _compared(row: Mapping[str, Any], arrays: Arrays) -> Compared:
    case = GeneratorCase(row, arrays, "g0/")
    generator, config = case.config, _recipe(case)
    if generator.noise_mix_type != "global":
        raise InputError("manifest: a train_step case has one noise a scene, noise_mix_type global")
    # As one group, `[scenes, slots, ...]`.
    groups = (case.scenes.replace(origin=None),)
    shape = (groups[0].valid.shape[0], generator.noise_dim)
    noises = [
        [checked(arrays, "noise_d", *shape)[None]],
        [checked(arrays, "noise_g", config.best_k, *shape)],
    ]

    def stored(prefix: str) -> dict[str, Any]:
        network = generator if prefix.startswith("g") else config.discriminator
        return {"params": params_from_torch(case.state(prefix), network)}

    example = jax.tree.map(lambda leaf: leaf[0], groups[0])
    fresh = jax.eval_shape(lambda: initial_state(generator, config, example, jax.random.key(0)))
    # Adam's state is all zeros before its first step.
    state = jax.tree.map(lambda leaf: np.zeros(leaf.shape, leaf.dtype), fresh)._replace(
        generator=stored("g0/"), discriminator=stored("d0/")
    )
    ours, metrics = _two_steps(generator, config, state, groups, noises)
    scalars = {
        name: (np.asarray(metrics[field]), checked(arrays, name)) for name, field in LOSSES.items()
    }

    def vector(params: Any) -> np.ndarray:
        return np.asarray(ravel_pytree(params)[0])

    return scalars | {
        name: (vector(ours[name]), vector(stored(f"{name}/")))
        for name in ("d_grad", "g_grad_clipped", "d1", "g1")
    }


@functools.partial(jax.jit, static_argnums=(0, 1))
def _two_steps(
    generator: GeneratorConfig, config: TrainConfig, state: TrainState, groups: Groups, noises
):
    """Gradients and parameters after, by the names they are stored under, and metrics."""
    (label_real, _), (label_fake, _) = config.label_real, config.label_fake
    d_gradient, d_metrics = discriminator_gradient(
        generator,
        config,
        state.generator,
        state.discriminator,
        groups,
        noises[0],
        label_real=label_real,
        label_fake=label_fake,
    )
    state = update_discriminator(config, state, d_gradient)
    g_gradient, g_metrics = generator_gradient(
        generator,
        config,
        state.generator,
        state.discriminator,
        groups,
        noises[1],
        label=label_real,
    )
    state = update_generator(config, state, g_gradient)
    ours = {
        "d_grad": d_gradient,
        "g_grad_clipped": clip_gradient(config, g_gradient),
        "d1": state.discriminator,
        "g1": state.generator,
    }
    return ours, d_metrics | g_metrics


def _recipe(case: GeneratorCase) -> TrainConfig:
    """The manifest's recipe; labels are numbers there and ranges with us."""
    if missing := [name for name in RECIPE.values() if name not in case.row]:
        raise InputError(f"manifest: {missing[0]} is missing")
    fields = {ours: case.row[theirs] for ours, theirs in RECIPE.items()}
    for name in ("label_real", "label_fake"):
        fields[name] = (fields[name], fields[name])
    fields |= {"adversarial_weight": 1.0, "criterion": "squared_displacement", "ema": 0.0}
    fields |= {"schedule": "constant", "weigh_scenes": "equally"}
    fields["discriminator"] = dataclasses.asdict(
        discriminator_config(case.row, case.state("d0/"), "manifest")
    )
    return from_json(TrainConfig, fields, "manifest")
