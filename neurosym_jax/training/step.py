"""One step of training by the gradient of a family's loss, and the loss of a family without one."""

import dataclasses
import functools
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
from jax import Array

from neurosym_jax.symbolic.soft import safe_root
from neurosym_jax.training.state import TrainState, update
from neurosym_jax.training.stream import Groups, augment

__all__ = ["gradient_rounds", "gradient_step", "variety_loss"]


def gradient_rounds(
    forecaster: Any, batches: Callable[[int], Any], recipe: Any, key: Array
) -> Callable[..., tuple[TrainState, Any]]:
    """See `Forecaster.rounds`; `batches` gives the batch of a step."""

    recipe = dataclasses.replace(recipe, seed=0)  # Seeds share the compiled step.

    def advance(state: TrainState, done: int, count: int) -> tuple[TrainState, Any]:
        rows = []
        for step in range(done, done + count):
            state, metrics = gradient_step(
                forecaster, recipe, key, state, batches(step)
            )
            rows.append(metrics)
        return state, {name: jnp.stack([row[name] for row in rows]) for name in rows[0]}

    return advance


@functools.partial(jax.jit, static_argnums=(0, 1), donate_argnums=3)
def gradient_step(
    forecaster: Any, recipe: Any, key: Array, state: TrainState, batch: Any
) -> tuple[TrainState, dict[str, Array]]:
    """The state after one step on a batch, and its metrics [], `loss` among them.

    `key` is the run's, the same for all steps. The buffers of `state` are donated.
    """
    # The key follows from the step, not from where the run was interrupted.
    step_key = jax.random.fold_in(key, state.step)

    def loss(params: Any) -> tuple[Array, dict[str, Array]]:
        return forecaster.loss(params, batch, step_key, recipe)

    (value, metrics), gradient = jax.value_and_grad(loss, has_aux=True)(state.params)
    return update(recipe, state, gradient), {"loss": value, **metrics}


def variety_loss(
    forecaster: Any, params: Any, groups: Groups, key: Array, recipe: Any
) -> tuple[Array, dict[str, Array]]:
    """[] metres: ADE and weighted FDE of the best joint sample of each scene, mean over people.

    The batch is augmented; every scene gets its own noise. Consumes `key`.
    """
    move_key, noise_key = jax.random.split(key)
    samples, spec = forecaster.best_of(recipe), forecaster.noise
    total, people = jnp.zeros(()), jnp.zeros(())
    for number, scenes in enumerate(augment(groups, move_key, recipe)):
        scenes = jax.tree.map(jnp.asarray, scenes)
        slots = scenes.valid.shape if spec.per_agent else scenes.valid.shape[:1]
        noise = spec.draw(
            jax.random.fold_in(noise_key, number), (samples, *slots, spec.dim)
        )
        forecast = jax.vmap(forecaster.forecast, in_axes=(None, 0, 1), out_axes=1)
        futures = forecast(params, scenes.replace(future=None), noise)
        distance = safe_root(jnp.square(futures - scenes.known_future[None]).sum(-1))
        error = distance.mean(-1) + recipe.fde_weight * distance[..., -1]  # [k, B, N]
        total += jnp.where(scenes.valid[None], error, 0).sum(-1).min(0).sum()
        people += scenes.valid.sum(dtype=people.dtype)
    return total / people, {}
