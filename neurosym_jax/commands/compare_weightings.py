"""Train networks of several weightings, and compare them."""

import dataclasses
from typing import ClassVar

from tyro.conf import Positional

from neurosym_jax.commands import sweep
from neurosym_jax.configuration import Count, refuse
from neurosym_jax.errors import InputError
from neurosym_jax.training.sweep import compare_sweep

__all__ = ["Options", "run"]


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
    family: tuple[str, ...] = ("neurosym",)
    """Families of networks that take it."""
    seeds: int = 8
    """Trainings of each weighting, with random seeds from 0 on."""
    seed: ClassVar[tuple[int, ...]] = ()
    init: ClassVar[None] = None  # Its network has its weighting.


def run(options: Options) -> int:
    """Train, test and compare; 1 if a training failed.

    Raises:
        InputError: see `sweep.plan_runs` and `training.sweep.compare_sweep`.
    """
    refuse(Count, {"--seeds": options.seeds})
    if options.weighting in options.against:
        raise InputError(f"--against {options.weighting}: is the weighting itself")
    values = {}
    for field in dataclasses.fields(sweep.Options):
        values[field.name] = getattr(options, field.name)
    values["weighting"] = (options.weighting, *options.against)
    values["seed"] = tuple(range(options.seeds))
    status = sweep.run(sweep.Options(**values))
    if not options.dry_run:
        print(compare_sweep(options.out, options.against))
    return status
