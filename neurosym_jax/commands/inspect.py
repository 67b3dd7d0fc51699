"""Say what a recording, or a folder of them, holds."""

from neurosym_jax.data.inspection import InspectOptions as Options
from neurosym_jax.data.inspection import inspect as run

__all__ = ["Options", "run"]
