"""Train a model: `python train.py --help`."""

from neurosym_jax.command import run_command

if __name__ == "__main__":
    from neurosym_jax.training.run import TrainOptions, train

    run_command(TrainOptions, train)
