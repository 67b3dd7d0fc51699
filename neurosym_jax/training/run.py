"""A training run: what is trained on what, its start, its steps, and the record to resume it by.

Everything random follows from (seed, step).
"""

import dataclasses
import hashlib
from collections.abc import Callable, Mapping
from typing import Any

import jax
import numpy as np
from jax import Array

from neurosym_jax.configuration import to_json
from neurosym_jax.data.windows import Windows
from neurosym_jax.forecasting.anchors import initial_anchors
from neurosym_jax.forecasting.forecasters import FORECASTERS
from neurosym_jax.runtime.process import COMPILED_QUICKLY, run_environment
from neurosym_jax.training.anchors import AnchorStream, anchor_step
from neurosym_jax.training.recipe import AnchorRecipe, refuse_other_recipe
from neurosym_jax.training.step import TrainState, initial_state, new_state, train_steps
from neurosym_jax.training.stream import SceneStream

__all__ = ["ROUND", "Advance", "Run", "record_of", "rounds_of", "start_of"]

ROUND = 25
"""Most steps between two updates of the progress bar."""

Advance = Callable[[TrainState, int, int], tuple[TrainState, Mapping[str, Any]]]
"""`(state, done, count) -> (state, metrics [count])`: `count` steps after `done` ones."""


@dataclasses.dataclass(frozen=True, eq=False)
class Run:
    """What is trained on what."""

    network: Any
    """The configuration of a generator, an anchors network or an anchor table."""
    recipe: Any
    """A `Recipe` for it."""
    training: Windows
    validation: Windows
    dataset: str | None = None
    """The data set that was left out, to be tested on; recorded with the model."""
    data: tuple[str, ...] = ()
    """Names of the data sets learned from."""
    options: str = ""
    """The file of options that repeats it, in YAML; empty where no command made it."""

    def __post_init__(self):
        """Refuse a recipe of another kind of network."""
        refuse_other_recipe(self.network, self.recipe)

    @property
    def kind(self) -> str:
        """The name of the forecaster that is trained."""
        return next(kind for kind, of in FORECASTERS.items() if of.Config is type(self.network))

    @property
    def samples(self) -> int:
        """Number of samples of which validation takes the best."""
        return self.recipe.best_k if self.kind == "generator" else self.network.samples


def start_of(run: Run) -> TrainState:
    """The state before training."""
    network, recipe = run.network, run.recipe

    def start(key: Array) -> TrainState:
        if isinstance(recipe, AnchorRecipe):
            return new_state(recipe, initial_anchors(network, key))
        return initial_state(network, recipe, key)

    return jax.jit(start, compiler_options=COMPILED_QUICKLY)(_key(run, 0))


def rounds_of(run: Run) -> Advance:
    """The function that trains `run` by a round; it may reuse the buffers of the state."""
    network, recipe, key = run.network, run.recipe, _key(run, 1)
    if isinstance(recipe, AnchorRecipe):
        anchors = AnchorStream(run.training, recipe)

        def advance(state: TrainState, done: int, count: int):
            losses = []
            for step in range(done, done + count):
                state, loss = anchor_step(network, recipe, key, state, *anchors.batch(step))
                losses.append(loss)
            return state, {"loss": np.array(losses)}

        return advance
    stream = SceneStream(run.training, recipe.batch_scenes, recipe.seed, recipe.max_agents)
    each = 2 if recipe.adversarial_weight else 1  # Each network has a batch of its own.

    def advance_generator(state: TrainState, done: int, count: int):
        groups = jax.tree.map(
            lambda leaf: leaf.reshape(count, each, *leaf.shape[1:]),
            stream.steps(done * each, count * each),
        )
        return train_steps(network, recipe, key, state, groups)

    return advance_generator


def _key(run: Run, part: int) -> Array:
    return jax.random.fold_in(jax.random.key(run.recipe.seed), part)


def record_of(run: Run) -> dict[str, Any]:
    """What must be equal for a run to be resumed with the same bits; JSON-able."""
    return {
        "forecaster": run.kind,
        "network": to_json(run.network),
        "training": to_json(run.recipe),
        "scene": run.dataset,
        "data": {"training": _digest(run.training), "validation": _digest(run.validation)},
        "environment": run_environment(),
    }


def _digest(windows: Windows) -> str:
    """SHA-256 of the windows themselves, whatever files they came from."""
    sha = hashlib.sha256()
    for array in (windows.position, windows.bounds, windows.identity):
        sha.update(np.ascontiguousarray(array).tobytes())
    return sha.hexdigest()
