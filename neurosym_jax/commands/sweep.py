"""Train and test many models."""

import dataclasses
import shlex

from neurosym_jax.training.sweep import Sweep, plan_runs, run_sweep

__all__ = ["Options", "run"]


@dataclasses.dataclass(frozen=True)
class Options(Sweep):
    """Train every model on every data set with every seed, test them, and make one table."""

    jobs: int | None = None
    """Trainings at once; default: one for each core."""
    dry_run: bool = False
    """List the runs and which of them are finished, each with its command; train nothing."""


def run(options: Options) -> int:
    """Train and test what `options` ask for; 1 if a training failed.

    Raises:
        InputError: see `plan_runs` and `run_sweep`.
    """
    runs = plan_runs(options)
    if not options.dry_run:
        return run_sweep(options, runs, options.jobs)
    for one in runs:
        state = "finished" if one.finished() else "left    "
        print(f"{state}  {shlex.join(['neurosym', 'train', *one.arguments])}")
    return 0
