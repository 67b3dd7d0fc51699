"""Train a model."""

from neurosym_jax.training.run import TrainOptions as Options
from neurosym_jax.training.run import train as run

__all__ = ["Options", "run"]
