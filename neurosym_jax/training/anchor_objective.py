"""The training of anchors and anchor tables: a step a batch, with an averaged state."""

import functools
from collections.abc import Mapping
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import optax
from jax import Array

from neurosym_jax.forecasting.anchors import apply_anchors, initial_anchors
from neurosym_jax.scene import Scene
from neurosym_jax.training.anchor_loss import anchor_loss, company
from neurosym_jax.training.anchor_stream import AnchorStream
from neurosym_jax.training.augmentation import augment
from neurosym_jax.training.objective import Objective
from neurosym_jax.training.recipe import AnchorRecipe
from neurosym_jax.training.run import Run
from neurosym_jax.training.step import averaged

__all__ = ["AnchorObjective", "AnchorState", "anchor_step"]


class AnchorState(NamedTuple):
    """The state of a training; a pytree of arrays."""

    step: Array
    """[] int32 steps done."""
    params: Any
    optimizer: Any
    average: Any
    """Averaged parameters, () where the recipe averages none."""


class AnchorObjective(Objective):
    """An `AnchorNetwork` or an `AnchorTable`."""

    def __init__(self, run: Run):
        """See `Objective`."""
        super().__init__(run)
        self._stream = AnchorStream(run.training, run.recipe)

    def start(self) -> AnchorState:
        """See `Objective.start`."""

        @jax.jit
        def initial(key: Array, weighting: Any) -> AnchorState:
            params = initial_anchors(self.run.network, key, weighting)
            average = jax.tree.map(jnp.copy, params) if self.run.recipe.ema else ()
            optimizer = _optimizer(self.run.recipe).init(params)
            return AnchorState(jnp.zeros((), jnp.int32), params, optimizer, average)

        return initial(self.keys[0], self.weighting())

    def advance(
        self, state: AnchorState, done: int, count: int
    ) -> tuple[AnchorState, Mapping[str, Any]]:
        """See `Objective.advance`."""
        network, recipe, key = self.run.network, self.run.recipe, self.keys[1]
        losses = []
        for step in range(done, done + count):
            state, loss = anchor_step(network, recipe, key, state, *self._stream.batch(step))
            losses.append(loss)
        return state, {"loss": np.array(losses)}

    def params(self, state: AnchorState) -> Any:
        """See `Objective.params`."""
        return state.average if self.run.recipe.ema else state.params


@functools.partial(jax.jit, static_argnums=(0, 1), donate_argnums=3)
def anchor_step(
    network: Any, recipe: AnchorRecipe, key: Array, state: AnchorState, scenes: Scene, crowd: Array
) -> tuple[AnchorState, Array]:
    """The state after one step on a batch, and its loss.

    Args:
        network: configuration of the network or the table.
        recipe: of the training.
        key: of the run, the same for all steps and not consumed.
        state: before the step; its buffers are donated.
        scenes: `[B, N, ...]`, before augmentation.
        crowd: [B] index of each scene's crowd.
    """
    (scenes,) = augment((scenes,), jax.random.fold_in(key, state.step), recipe)
    observed, valid = jnp.asarray(scenes.observed), jnp.asarray(scenes.valid)

    def loss(params: Any) -> Array:
        apply = functools.partial(apply_anchors, network, params)
        forecast, log_probability = jax.vmap(
            lambda observed, valid, company: apply(observed, valid, company=company)
        )(observed, valid, company(valid, crowd))
        future = jnp.asarray(scenes.known_future)
        return anchor_loss(forecast, log_probability, future, valid, crowd, recipe)

    value, gradient = jax.value_and_grad(loss)(state.params)
    update, optimizer = _optimizer(recipe).update(gradient, state.optimizer, state.params)
    params: Any = optax.apply_updates(state.params, update)
    average = averaged(recipe.ema, state.step, state.average, params) if recipe.ema else ()
    return AnchorState(state.step + 1, params, optimizer, average), value


def _optimizer(recipe: AnchorRecipe) -> optax.GradientTransformation:
    warmup = min(recipe.warmup_steps, recipe.steps // 2)
    rate = optax.warmup_cosine_decay_schedule(0.0, recipe.learning_rate, warmup, recipe.steps)
    clip = optax.clip_by_global_norm(recipe.clip_norm) if recipe.clip_norm else optax.identity()
    return optax.chain(clip, optax.adam(rate))
