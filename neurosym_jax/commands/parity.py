"""Compare our numbers with torch's, output by output."""

from neurosym_jax.interop.parity import ParityOptions as Options
from neurosym_jax.interop.parity import parity as run

__all__ = ["Options", "run"]
