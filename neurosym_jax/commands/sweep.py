"""Train and test many models, a process each."""

from neurosym_jax.sweeps.sweep import SweepOptions as Options
from neurosym_jax.sweeps.sweep import sweep as run

__all__ = ["Options", "run"]
