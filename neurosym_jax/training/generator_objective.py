"""The training of SGAN and NeuroSyM: compiled chunks of steps on batches of all size classes."""

from collections.abc import Mapping
from typing import Any

import jax

from neurosym_jax.runtime.memory import refuse_beyond_memory
from neurosym_jax.training.objective import CHUNK, Objective
from neurosym_jax.training.run import Run
from neurosym_jax.training.step import TrainState, initial_state, train_steps
from neurosym_jax.training.stream import SceneStream

__all__ = ["GeneratorObjective"]


class GeneratorObjective(Objective):
    """A generator, with a discriminator where the recipe has an adversarial term."""

    def __init__(self, run: Run):
        """See `Objective`.

        Raises:
            InputError: for batches that memory cannot hold.
        """
        super().__init__(run)
        recipe = run.recipe
        self._networks = 2 if recipe.adversarial_weight else 1  # A step takes a batch for each.
        self._stream = SceneStream(
            run.training, recipe.batch_scenes, recipe.seed, recipe.max_agents
        )
        self._refuse_too_large()

    def start(self) -> TrainState:
        """See `Objective.start`."""
        example = jax.tree.map(lambda leaf: leaf[0, 0], self._stream.steps(0, 1)[0])
        network, recipe = self.run.network, self.run.recipe
        return initial_state(network, recipe, example, self.keys[0], self.weighting())

    def advance(
        self, state: TrainState, done: int, count: int
    ) -> tuple[TrainState, Mapping[str, Any]]:
        """See `Objective.advance`."""
        each = self._networks
        groups = jax.tree.map(
            lambda leaf: leaf.reshape(count, each, *leaf.shape[1:]),
            self._stream.steps(done * each, count * each),
        )
        return train_steps(self.run.network, self.run.recipe, self.keys[1], state, groups)

    def params(self, state: TrainState) -> Any:
        """See `Objective.params`."""
        return state.average if self.run.recipe.ema else state.generator

    def _refuse_too_large(self) -> None:
        """Refuse batches that memory cannot hold.

        A lower bound: positions of a round's batches, the k forecasts of one, and the numbers that
        pooling keeps of each pair for its gradient.
        """
        config, generator = self.run.recipe, self.run.network
        slots = sum(scenes * size for scenes, size in self._stream.shapes)
        pairs = sum(scenes * size**2 for scenes, size in self._stream.shapes)
        numbers = CHUNK * self._networks * slots * 2 * (2 * generator.obs_len + generator.pred_len)
        numbers += config.best_k * slots * (2 * generator.pred_len + generator.decoder_h_dim)
        numbers += 2 * pairs * generator.pooling.pair_numbers
        remedy = "lower batch_scenes, best_k or max_agents with --set"
        refuse_beyond_memory(f"a batch of {config.batch_scenes} scenes", 4 * numbers, remedy)
