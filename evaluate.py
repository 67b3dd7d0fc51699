"""Evaluate checkpoints: `python evaluate.py --help`."""

from neurosym_jax.command import run_command

if __name__ == "__main__":
    from neurosym_jax.evaluation.run import EvaluateOptions, run_evaluation

    run_command(EvaluateOptions, run_evaluation)
