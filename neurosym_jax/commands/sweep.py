"""Train and test many models."""

import dataclasses
import shlex
from pathlib import Path
from typing import Literal

from neurosym_jax.training.sweep import run_sweep
from neurosym_jax.training.sweep_plan import plan_runs

__all__ = ["Options", "run"]


@dataclasses.dataclass(frozen=True)
class Options:
    """Train every model on every data set with every seed, test them, and make one table."""

    models: tuple[str, ...] = ("sgan", "neurosym")
    """sgan, neurosym (as described), anchors, anchor_table, neurosym_ros, or any other pooling's
    name."""
    datasets: tuple[str, ...] = ()
    """Data sets to leave out of training and test on; default: all that the data has."""
    seeds: tuple[int, ...] = (0, 1, 2)
    """Random seeds, a training each."""
    obs_len: int = 8
    """Observed steps."""
    pred_lens: tuple[int, ...] = (8,)
    """Steps to forecast, a model each."""
    weightings: tuple[str, ...] = ("cnd",)
    """Weightings of NeuroSyM, a model each; see train's --weighting."""
    recipe: Literal["ours", "sgan", "anchors"] | None = None
    """How the models are trained, see docs/training.md; default: as `train` does each."""
    steps: int | None = None
    """Steps of training; default: the recipe's."""
    set: tuple[str, ...] = ()
    """Changes to the recipe, NAME=VALUE."""
    network: tuple[str, ...] = ()
    """Changes to the networks, NAME=VALUE."""
    data: Path | None = None
    """ETH/UCY as SGAN arranges it; default: the embedded simulations."""
    out: Path = Path("runs/sweep")
    """Folder of the runs, of sweep.json and of sweep.md."""
    jobs: int | None = None
    """Trainings at once; default: one for each core."""
    dry_run: bool = False
    """List the runs and which of them are finished, each with its command; train nothing."""


def run(options: Options) -> int:
    """Train and test what `options` ask for; 1 if a training failed.

    Raises:
        InputError: see `plan_runs` and `run_sweep`.
    """
    runs = plan_runs(
        options.out,
        models=options.models,
        weightings=options.weightings,
        datasets=options.datasets,
        seeds=options.seeds,
        obs_len=options.obs_len,
        pred_lens=options.pred_lens,
        recipe=options.recipe,
        steps=options.steps,
        changes=options.set,
        network=options.network,
        data=options.data,
    )
    if options.dry_run:
        for one in runs:
            state = "finished" if one.finished() else "left    "
            print(f"{state}  {shlex.join(['neurosym', 'train', *one.arguments])}")
        return 0
    return run_sweep(runs, options.out, data=options.data, jobs=options.jobs)
