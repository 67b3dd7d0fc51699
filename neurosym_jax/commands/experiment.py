"""Repeat the robot paper's experiment on simulated recordings."""

from studies.experiment.experiment import ExperimentOptions as Options
from studies.experiment.experiment import experiment as run

__all__ = ["Options", "run"]
