"""Repeat the robot paper's experiment on simulated recordings."""

import dataclasses
import sys
from pathlib import Path

from neurosym_jax.errors import InputError

__all__ = ["Options", "run"]

REPOSITORY = Path(__file__).resolve().parents[2]


@dataclasses.dataclass(frozen=True)
class Options:
    """Repeat the robot paper's experiment on simulated recordings, and write its report."""

    out: Path = Path("results/experiment")
    """Folder for report, figures and recordings; it must be new or empty."""
    model_a: tuple[Path, ...] = ()
    """Models for scenario A; by default those that ship for zara1."""
    model_b: tuple[Path, ...] = ()
    """Models for scenario B; by default those trained on THÖR that ship, else those of A."""
    seconds: float = 120.0
    """Length of a recording."""
    seeds: tuple[int, int, int, int] = (1, 2, 3, 4)
    """Of the recordings, two of A and two of B."""
    samples: int = 20
    """Futures that each model draws."""


def run(options: Options) -> None:
    """Do the experiment.

    Raises:
        InputError: for models that are not there, a folder that holds something, or where the
            package was installed without its repository.
    """
    if not (REPOSITORY / "studies" / "experiment").is_dir():
        raise InputError("the experiment is a study of the repository, which is not installed here")
    given = {each.name: getattr(options, each.name) for each in dataclasses.fields(Options)}
    sys.path.insert(0, str(REPOSITORY))
    from studies.experiment.experiment import experiment

    print(f"the report is {experiment(**given)}")
