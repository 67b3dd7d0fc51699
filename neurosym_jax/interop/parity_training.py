"""How far one training step is from a torch run that somebody saved: a case of `interop.parity`.

One discriminator step, then one generator step that the new discriminator scores, on one batch,
with given noises and no augmentation. The parameters before, the noises and the batch are torch's;
losses, gradients and the parameters after are compared, all parameters of a network as one vector.
"""

import functools
from collections.abc import Mapping
from typing import Any

import jax
import numpy as np
from jax.flatten_util import ravel_pytree

from neurosym_jax.config import FORMAT, GeneratorConfig, from_json, to_json
from neurosym_jax.errors import InputError
from neurosym_jax.interop.names import discriminator_params_from_torch, generator_params_from_torch
from neurosym_jax.interop.parity_networks import (
    Arrays,
    Compared,
    discriminator_config,
    floats,
    generator_config,
    make_scenes,
    manifest_field,
    scene_bounds,
    stacked,
    state_dict,
)
from neurosym_jax.scene import Scene, model_dtype, relative_positions
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

__all__ = ["train_step"]

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

    Raises:
        InputError: for a case that has not one noise a scene.
    """
    generator, config = generator_config(row), _recipe(row)
    if generator.noise_mix_type != "global":
        raise InputError("manifest: a train_step case has one noise a scene, noise_mix_type global")
    groups = (_batch(generator, arrays),)
    shape = (groups[0].valid.shape[0], generator.noise_dim)
    noises = [
        [floats(arrays, "noise_d", *shape)[None]],
        [floats(arrays, "noise_g", config.best_k, *shape)],
    ]

    def of_generator(prefix: str) -> dict[str, Any]:
        return {"params": generator_params_from_torch(state_dict(arrays, prefix), generator)}

    def of_discriminator(prefix: str) -> dict[str, Any]:
        state = state_dict(arrays, prefix)
        return {"params": discriminator_params_from_torch(state, config.discriminator)}

    example = jax.tree.map(lambda leaf: leaf[0], groups[0])
    fresh = jax.eval_shape(lambda: initial_state(generator, config, example, jax.random.key(0)))
    # Adam's state is all zeros before its first step.
    state = jax.tree.map(lambda leaf: np.zeros(leaf.shape, leaf.dtype), fresh)._replace(
        generator=of_generator("g0/"), discriminator=of_discriminator("d0/")
    )
    ours, metrics = _two_steps(generator, config, state, groups, noises)
    theirs = {
        "d_grad": of_discriminator("d_grad/"),
        "g_grad_clipped": of_generator("g_grad_clipped/"),
        "d1": of_discriminator("d1/"),
        "g1": of_generator("g1/"),
    }
    scalars = {
        name: (np.asarray(metrics[field]), floats(arrays, name)) for name, field in LOSSES.items()
    }
    return scalars | {
        name: (np.asarray(ravel_pytree(ours[name])[0]), np.asarray(ravel_pytree(tree)[0]))
        for name, tree in theirs.items()
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


def _recipe(row: Mapping[str, Any]) -> TrainConfig:
    """The manifest's recipe; labels are numbers there and ranges with us."""
    fields = {ours: manifest_field(row, theirs) for ours, theirs in RECIPE.items()}
    for name in ("label_real", "label_fake"):
        fields[name] = (fields[name], fields[name])
    fields |= {"adversarial_weight": 1.0, "criterion": "squared_displacement", "ema": 0.0}
    fields |= {"schedule": "constant", "weigh_scenes": "equally"}
    fields["discriminator"] = to_json(discriminator_config(row))
    return from_json(TrainConfig, {"format": FORMAT, **fields}, "manifest")


def _batch(generator: GeneratorConfig, arrays: Arrays) -> Scene:
    """The batch as one group, `[scenes, slots, ...]`, with the stored displacements."""
    steps = generator.obs_len + generator.pred_len
    traj = floats(arrays, "traj", None, steps, 2).astype(np.float64)
    observed = traj[:, : generator.obs_len]
    traj_rel = floats(arrays, "traj_rel", *traj.shape)[:, : generator.obs_len]
    bounds = scene_bounds(arrays, len(traj))

    def future(positions: np.ndarray, scene: Scene) -> np.ndarray:
        return relative_positions(positions, np.asarray(scene.origin)).astype(model_dtype())

    scenes = [
        scene.replace(future=future(traj[a:b, generator.obs_len :], scene))
        for scene, (a, b) in zip(make_scenes(observed, traj_rel, bounds), bounds)
    ]
    return stacked(scenes, bounds)
