"""Compare a sweep's models, with intervals."""

from neurosym_jax.sweeps.report import ReportOptions as Options
from neurosym_jax.sweeps.report import report as run

__all__ = ["Options", "run"]
