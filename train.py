"""Train a model: `python train.py --help`."""

from neurosym_jax.command import run_command
from neurosym_jax.training.run import TrainOptions, train

if __name__ == "__main__":
    run_command(TrainOptions, train)
