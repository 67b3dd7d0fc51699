"""Evaluate checkpoints: `python evaluate.py --help`."""

from neurosym_jax.command import run_command
from neurosym_jax.evaluation.run import EvaluateOptions, run_evaluation

if __name__ == "__main__":
    run_command(EvaluateOptions, run_evaluation)
