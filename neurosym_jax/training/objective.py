"""What the training loop needs to know of a kind of forecaster: its state, and its steps."""

import abc
from collections.abc import Iterator, Mapping
from typing import Any

import jax

from neurosym_jax.data.batching import make_batches
from neurosym_jax.symbolic.weighting import initial_parameters
from neurosym_jax.training.run import Run

__all__ = ["CHUNK", "Objective"]

CHUNK = 25
"""Most steps between two updates of the progress bar."""


class Objective(abc.ABC):
    """The training of a run. Everything random follows from the recipe's seed and the step."""

    def __init__(self, run: Run):
        """Prepare the batches; `keys` are those of the initial state and of the steps."""
        self.run = run
        seed = jax.random.key(run.recipe.seed)
        self.keys = [jax.random.fold_in(seed, part) for part in (0, 1)]

    @abc.abstractmethod
    def start(self) -> Any:
        """The state before training: a pytree of arrays with a field `step`."""

    @abc.abstractmethod
    def advance(self, state: Any, done: int, count: int) -> tuple[Any, Mapping[str, Any]]:
        """The state after `count` further steps, and metrics [count] by name.

        Args:
            state: after `done` steps; its buffers may be reused.
            done: equal to `state.step`.
            count: at most `CHUNK`.
        """

    @abc.abstractmethod
    def params(self, state: Any) -> Any:
        """The parameters that are validated and kept."""

    def weighting(self) -> dict[str, Any]:
        """Parameters of the network's weighting before training, if it has one."""
        weighting = getattr(self.run.network, "weighting", None)
        return initial_parameters(weighting, self._observed())

    def _observed(self) -> Iterator[tuple[Any, Any]]:
        for batch in make_batches(self.run.training):
            yield batch.scene.observed, batch.scene.valid
