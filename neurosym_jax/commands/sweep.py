"""Train and test many models."""

# pyright: reportIncompatibleVariableOverride=false
# Options of `train` that have one value have several here.

import dataclasses
import itertools
import shlex
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, ClassVar

from neurosym_jax.commands import train
from neurosym_jax.commands._options import open_data, options_text, refuse_unused
from neurosym_jax.configuration import Count, refuse
from neurosym_jax.data.recordings import Source
from neurosym_jax.errors import InputError
from neurosym_jax.models.forecaster import forecaster_of
from neurosym_jax.training.run import make_config
from neurosym_jax.training.sweep import SweepRun, run_sweep, unfinished

__all__ = ["Options", "plan_runs", "run", "run_planned"]


@dataclasses.dataclass(frozen=True)
class Options(train.Options):
    """Train every model on every data set with every seed, test them, and make one table.

    `neurosym sweep FILE.yaml` reads options from a file; those after it override the
    file.
    """

    FIRST: ClassVar[str] = "data dataset pred_len family weighting seed out jobs"
    GROUPS: ClassVar[dict[str, str]] = train.Options.GROUPS | {
        "output": "out jobs dry_run quiet log",
    }
    family: tuple[str, ...] = ("sgan", "neurosym")
    """Families of networks, see `neurosym train`."""
    pooling: tuple[str, ...] = ()
    """Poolings, a model each of every network that has it; default: the papers'."""
    weighting: tuple[str, ...] = ()
    """Weightings, a model each of every network that takes it; default: cnd for NeuroSyM."""
    dataset: tuple[str, ...] = ()
    """Data sets to leave out of training and to test on; default: all that the data has."""
    pred_len: tuple[int, ...] = ()
    """Steps to forecast, a model each; default: 8."""
    set: tuple[str, ...] = ()
    """Changes to the recipe, NAME=VALUE; of several values, learning_rate=0.01,0.001, a training
    each with every combination."""
    network: tuple[str, ...] = ()
    """Changes to the network, as --set."""
    fold: tuple[str, ...] = ()
    """Folds, as 1/5 2/5 3/5 4/5 5/5, a training each."""
    seed: tuple[int, ...] = (0, 1, 2)
    """Random seeds, a training each."""
    out: Path = Path("runs/sweep")
    """Folder of the runs, sweep.json, sweep.md and sweep.yaml, which repeats the sweep."""
    jobs: int | None = None
    """Trainings at once; default: one for each core."""
    dry_run: bool = False
    """Write each run's recipe.yaml and list the commands that train them; train nothing."""
    train_on: ClassVar[tuple[str, ...]] = ()
    validate_on: ClassVar[tuple[str, ...]] = ()
    resume: ClassVar[bool] = False


def run(options: Options) -> int:
    """Train and test what `options` ask for; 1 if a training failed.

    Raises:
        InputError: see `plan_runs` and `training.sweep.run_sweep`.
    """
    return run_planned(options, *plan_runs(options))


def run_planned(options: Options, source: Source, runs: list[SweepRun]) -> int:
    """`run` of what `plan_runs` returned."""
    refuse(Count, {"--jobs": options.jobs}, optional=True)
    if not options.dry_run:
        return run_sweep(runs, source, options.out, options_text(options), options.jobs)
    left = unfinished(runs)
    for sweep_run in runs:
        state = "left    " if sweep_run in left else "finished"
        print(f"{state}  {shlex.join(['neurosym', *sweep_run.command])}")
    return 0


def plan_runs(options: Options) -> tuple[Source, list[SweepRun]]:
    """What is tested on, and a run for each seed, model, data set and horizon, in that order.

    Raises:
        InputError: for nothing to train, an unknown data set, a pooling, a weighting or
            a change that no model takes, or two runs of one name.
    """
    for name in ("family", "seed"):
        if not getattr(options, name):
            raise InputError(f"--{name}: at least one is needed")
    first = options.dataset[0] if options.dataset else None
    config, *_ = train.configured(
        train.Options(period=options.period, init=options.init)
    )
    source = open_data(
        options.data, options.read, first, options.train_also, period=config.period
    )
    for name in options.dataset:
        if name not in source.scenes:
            raise InputError(
                f"unknown dataset {name!r}: there are {', '.join(source.scenes)}"
            )
    runs: dict[Path, SweepRun] = {}
    for run_options, label in _varied(options, options.dataset or source.scenes):
        config, *_ = train.configured(run_options)
        variant = forecaster_of(config).variant
        parts = [
            variant,
            *(change for change in label if not _says(variant, change)),
            run_options.dataset,
            config.obs_len,
            config.pred_len,
            f"seed{run_options.seed}",
        ]
        name = "_".join(map(str, parts))
        name = name.replace("/", "of").replace(" ", "")
        folder = options.out / name
        if folder in runs:
            raise InputError(f"{name}: two runs of the sweep have this name")
        text = options_text(dataclasses.replace(run_options, out=folder))
        title = ", ".join([forecaster_of(config).title, *label])
        runs[folder] = SweepRun(folder, text, ", ".join(label), title)
    return source, list(runs.values())


def _says(variant: str, change: str) -> bool:
    """Whether the name `variant` of a network has NAME_VALUE for the change NAME=VALUE."""
    return f"_{change.replace('=', '_')}_" in f"{variant}_"


def _varied(
    options: Options, datasets: Sequence[str]
) -> Iterator[tuple[train.Options, list[str]]]:
    """The options of each run, and what tells its model apart from others of the sweep."""
    names = [field.name for field in dataclasses.fields(train.Options)]
    common = {name: getattr(options, name) for name in names}
    varied = set()
    for change in (*options.set, *options.network):
        if len(_values(change)) > 1:
            varied.add(change.partition("=")[0])
    # Seed by seed: an interrupted sweep has trained all models as often.
    for seed, model, dataset, pred_len, fold, changes, network in itertools.product(
        options.seed,
        _models(options),
        datasets,
        options.pred_len or (None,),
        options.fold or (None,),
        itertools.product(*map(_values, options.set)),
        itertools.product(*map(_values, options.network)),
    ):
        own = {
            **model,
            "dataset": dataset,
            "pred_len": pred_len,
            "seed": seed,
            "fold": fold,
            "set": changes,
            "network": network,
        }
        label = []
        for change in (*changes, *network):
            if change.partition("=")[0] in varied:
                label.append(change)
        if fold:
            label.append(f"fold {fold}")
        yield train.Options(**{**common, **own}), label


def _values(change: str) -> list[str]:
    """NAME=VALUE for each value of `NAME=VALUE,VALUE...`.

    Commas within brackets, and those before an option of a component
    (`pooling=social,grid_size=9`) separate no values.
    """
    name, _, text = change.partition("=")
    parts = text.split(",")
    if text[:1] in ("[", "{") or any("=" in part for part in parts):
        return [change]
    return [f"{name}={part}" for part in parts]


def _models(options: Options) -> list[dict[str, Any]]:
    """Each network with each pooling and each weighting that it takes; or the --init model's."""
    if options.init is not None:
        names = ("family", "pooling", "weighting", "network")
        refuse_unused(options, names, "with --init, which has its network")
        return [dict.fromkeys(("family", "pooling", "weighting"))]
    taken: dict[str, dict[str, list[Any]]] = {}
    for option in ("pooling", "weighting"):
        taken[option] = {family: [] for family in options.family}
        for value in getattr(options, option):
            refused = []
            for family in options.family:
                try:
                    make_config(family, changes=[f"{option}={value}"])
                    taken[option][family].append(value)
                except InputError as error:
                    refused.append(error)
            if len(refused) == len(options.family):
                raise refused[-1]
    networks = []
    for family in options.family:
        poolings = taken["pooling"][family] or [None]
        weightings = taken["weighting"][family] or [None]
        for pooling, weighting in itertools.product(poolings, weightings):
            networks.append(
                {"family": family, "pooling": pooling, "weighting": weighting}
            )
    return networks
