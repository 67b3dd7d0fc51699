"""The runs of a sweep: every model on every data set with every seed, each a `neurosym train`."""

import dataclasses
import itertools
import json
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from neurosym_jax.configuration import to_json
from neurosym_jax.data.sources import open_source
from neurosym_jax.errors import InputError
from neurosym_jax.models.poolings import POOLINGS
from neurosym_jax.plugins import loaded
from neurosym_jax.training.network import (
    ANCHORS,
    POOLING_OF,
    model_name,
    named_network,
    usual_recipe,
)
from neurosym_jax.training.recipe import Recipe, make_recipe

RUN = "run.json"
__all__ = ["SweepRun", "plan_runs"]


@dataclasses.dataclass(frozen=True)
class SweepRun:
    """One training of a sweep."""

    network: Any
    recipe: Recipe
    dataset: str
    folder: Path
    arguments: tuple[str, ...]
    """Of `neurosym train`."""

    @property
    def model(self) -> Path:
        """The folder of its model, which is there once the run is finished."""
        return self.folder / "model"

    def facts(self) -> dict[str, Any]:
        """The content of `run.json` of the finished run.

        Raises:
            InputError: where it cannot be read.
        """
        try:
            return json.loads((self.folder / RUN).read_text())
        except (OSError, ValueError) as error:
            raise InputError(f"{self.folder / RUN}: cannot be read ({error})") from None

    def finished(self) -> bool:
        """Whether the run has its model.

        Raises:
            InputError: where the model has another network or recipe than the sweep's.
        """
        if not self.model.is_dir() or not (self.folder / RUN).is_file():
            return False
        facts = self.facts()
        wanted = {"network": to_json(self.network), "training": to_json(self.recipe)}
        for part, fields in json.loads(json.dumps(wanted)).items():
            for name, value in fields.items():
                if facts[part].get(name) != value:
                    raise InputError(
                        f"{self.folder}: was trained with {name} = {facts[part].get(name)}, "
                        f"not {value}: choose another --out"
                    )
        return True


def plan_runs(
    out: Path,
    *,
    models: Sequence[str],
    weightings: Sequence[str],
    datasets: Sequence[str] = (),
    seeds: Sequence[int] = (0,),
    obs_len: int = 8,
    pred_lens: Sequence[int] = (8,),
    recipe: str | None = None,
    steps: int | None = None,
    changes: Sequence[str] = (),
    network: Sequence[str] = (),
    data: Path | None = None,
) -> list[SweepRun]:
    """One run for each seed, model, weighting, data set and horizon, in that order.

    Args:
        out: folder of the runs' folders.
        models: `sgan`, `neurosym`, `anchors`, `anchor_table`, or a pooling's name.
        weightings: for each model that takes them, see `training.network.named_weighting`.
        datasets: to leave out of training; none for all that `data` has.
        seeds: of the trainings.
        obs_len: observed steps.
        pred_lens: steps to forecast.
        recipe: its name; None for that of each model.
        steps: of training; None for the recipe's.
        changes: to the recipe, NAME=VALUE.
        network: changes to the networks, NAME=VALUE.
        data: as `data.open_source` takes it.

    Raises:
        InputError: for nothing to train, an unknown data set, model or weighting, or a change that
            does not fit.
    """
    if not seeds or not models:
        raise InputError("--seeds and --models: at least one of each is needed")
    source = open_source(data, datasets[0] if datasets else None)
    if unknown := [name for name in datasets if name not in source.scenes]:
        raise InputError(f"unknown dataset {unknown[0]!r}: there are {', '.join(source.scenes)}")
    common = _options({"recipe": recipe, "obs-len": obs_len, "steps": steps, "data": data})
    common += ["--resume", *(["--set", *changes] if changes else [])]
    common += ["--network", *network] if network else []
    common += [part for plugin in loaded() for part in ("--plugin", plugin)]
    runs: dict[Path, SweepRun] = {}
    # Seed by seed: an interrupted sweep has trained all models as often.
    every = itertools.product(
        seeds, list(_networks(models, weightings)), datasets or source.scenes, pred_lens
    )
    for seed, named, dataset, pred_len in every:
        made = named_network(**named, obs_len=obs_len, pred_len=pred_len, changes=network)
        how = recipe or usual_recipe(named["model"])
        config = make_recipe(how, seed=seed, steps=steps, changes=changes)
        folder = out / f"{model_name(made)}_{dataset}_{obs_len}_{pred_len}_seed{seed}"
        own = {"dataset": dataset, "pred-len": pred_len, "seed": seed, **named, "out": folder}
        runs[folder] = SweepRun(made, config, dataset, folder, (*_options(own), *common))
    return list(runs.values())


def _options(values: Mapping[str, Any]) -> list[str]:
    """The options of a command line, of the values that are given."""
    given = {name: value for name, value in values.items() if value is not None}
    return [str(part) for name, value in given.items() for part in (f"--{name}", value)]


def _networks(models: Sequence[str], weightings: Sequence[str]) -> Iterator[dict[str, Any]]:
    """The arguments of `named_network` that make `models`."""
    for model in models:
        if model in ANCHORS:
            yield {"model": model}
            continue
        pooling = POOLING_OF.get(model, model)
        if "alpha" not in POOLINGS[pooling].inputs:
            yield {"model": "sgan", "pooling": pooling}
            continue
        for weighting in weightings:
            yield {"model": "neurosym", "pooling": pooling, "weighting": weighting}
