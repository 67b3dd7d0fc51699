"""Train networks of several weightings, and compare them."""

# pyright: reportIncompatibleVariableOverride=false
# Options of `sweep` that have several values have one here.

import dataclasses
import math
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import ClassVar

import yaml
from tyro.conf import Positional

from neurosym_jax.commands import sweep
from neurosym_jax.configuration import Count, refuse
from neurosym_jax.errors import InputError
from neurosym_jax.evaluation.intervals import half_interval
from neurosym_jax.training.sweep import ENOUGH, SweepRun, compare_sweep

__all__ = ["SPREAD", "Options", "expected_power", "run"]

SPREAD = {"zara2": 1.0, "corridors": 3.7}
"""Deviation over 24 seeds of the difference in joint ADE of `quantised` from `ones`, in %, by
place: `docs/weighting.csv`."""


@dataclasses.dataclass(frozen=True)
class Options(sweep.Options):
    """Train networks that differ in their weighting alone, test them, and compare them.

    The same seeds have the same first parameters, batches and noise. It is `neurosym
    sweep`, then `neurosym report`: called again, it goes on.
    """

    FIRST: ClassVar[str] = "weighting against seeds plugin data dataset out jobs"
    GROUPS: ClassVar[dict[str, str]] = sweep.Options.GROUPS | {
        "model": "weighting against seeds family pooling network steps",
    }
    weighting: Positional[str] = "cnd"
    """The weighting: a name, with options as NAME,OPTION=VALUE."""
    against: tuple[str, ...] = ("ones", "shuffled")
    """Weightings to compare with: none, and that of wrong pairs."""
    family: str = "neurosym"
    """The family of networks, one that takes weightings."""
    pooling: str | None = None
    """Pooling of NeuroSyM: as_described (default) or neurosym_ros; or a plugin's."""
    pred_len: int = 8
    """Steps to forecast."""
    seeds: int = 8
    """Trainings of each weighting, with random seeds from 0 on."""
    out: Path = Path("runs/weightings")
    """Folder of the runs, sweep.json, sweep.yaml, which repeats the sweep, and report.md."""
    seed: ClassVar[tuple[int, ...]] = ()
    init: ClassVar[None] = None  # Its network has its weighting.


def run(options: Options) -> int:
    """Train, test and compare; 1 if a training failed.

    Raises:
        InputError: where something else than the weighting differs; see
            `sweep.plan_runs`.
    """
    refuse(Count, {"--seeds": options.seeds})
    if options.weighting in options.against:
        raise InputError(f"--against {options.weighting}: is the weighting itself")
    values = {}
    for field in dataclasses.fields(sweep.Options):
        values[field.name] = getattr(options, field.name)
    values["family"] = (options.family,)
    values["pooling"] = (options.pooling,) if options.pooling else ()
    values["pred_len"] = (options.pred_len,)
    values["weighting"] = (options.weighting, *options.against)
    values["seed"] = tuple(range(options.seeds))
    planned = sweep.Options(**values)
    source, runs = sweep.plan_runs(planned)
    # Before the first training, not after the last.
    titles = [_title(name, runs) for name in values["weighting"]]
    print(expected_power(options.seeds), file=sys.stderr)
    status = sweep.run_planned(planned, source, runs)
    if not options.dry_run:
        # The sweep has printed the table of errors.
        print(compare_sweep(options.out, titles[1:], errors=False))
    return status


def expected_power(seeds: int) -> str:
    """What difference between weightings `seeds` could tell in our own study, in a line.

    How much trainings on other data spread is not known before they are trained.
    """
    if seeds < ENOUGH:
        return f"Fewer than {ENOUGH} seeds tell nothing of how much trainings differ."
    share = half_interval(seeds - 1) / math.sqrt(seeds)
    differences = [
        f"{share * spread:.1f} % ({place})" for place, spread in SPREAD.items()
    ]
    return (
        f"{seeds} seeds told differences in joint ADE of {' and '.join(differences)} in our "
        "study of weightings; your data may need more."
    )


def _title(weighting: str, runs: Sequence[SweepRun]) -> str:
    """What tables call the one model of `weighting`.

    Raises:
        InputError: where several have it.
    """
    titles = {}
    for planned in runs:
        if yaml.safe_load(planned.options).get("weighting") == weighting:
            titles[planned.title] = None
    if len(titles) != 1:
        raise InputError(
            f"weighting {weighting}: models must differ in their weighting alone, "
            f"and there are {'; '.join(titles) or 'none'}"
        )
    return next(iter(titles))
