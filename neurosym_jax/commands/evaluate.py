"""Test models beside the baselines: tables, figures, JSON."""

from neurosym_jax.evaluation.run import EvaluateOptions as Options
from neurosym_jax.evaluation.run import run_evaluation as run

__all__ = ["Options", "run"]
