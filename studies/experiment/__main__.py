"""Repeat the robot paper's experiment on simulated recordings: `--help` lists the options."""

import sys

import tyro

from neurosym_jax.errors import InputError
from neurosym_jax.runtime.process import enable_compilation_cache, tune
from studies.experiment.experiment import experiment

if __name__ == "__main__":
    tune()
    enable_compilation_cache()
    try:
        print(f"the report is {tyro.cli(experiment)}")
    except InputError as error:
        sys.exit(f"error: {error}")
