"""Forecasts after 2 to 8 observed steps: layers for incomplete histories, on networks that stay.

NPROC=1 python -m studies.histories train DATA HERMES OUT [NAME ...] [--seed N] [--steps N]
NPROC=1 python -m studies.histories test DATA OUT > OUT/histories.csv

The first writes OUT/NAME of checkpoints/anchors_*, by default of all: in every scene a
person was seen for a random number of steps, 2 to 7, or for all. What a network
forecasts of people who were seen for all steps stays as it is, bit by bit. DATA and
HERMES are those of `studies.points`, and nothing is chosen by a validation. The second
prints energy scores and joint errors on the data sets that networks left out, with
everybody's history cut to 2, 3, 4, 6 and 8 steps, beside constant velocity, sampled.
"""

import csv
import dataclasses
import sys
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import tyro
from jax import Array

from neurosym_jax.data.recordings import open_source
from neurosym_jax.data.windows import Windows, cut_windows, make_batches
from neurosym_jax.evaluation.scores import score_forecaster
from neurosym_jax.models.anchors.recipe import AnchorRecipe
from neurosym_jax.models.baselines import ConstantVelocitySampled
from neurosym_jax.models.disk import load_model
from neurosym_jax.models.forecast import Model
from neurosym_jax.runtime.process import enable_compilation_cache, tune
from studies.points import Folders, Learning, layers_of, with_layers, write_models

RECIPE = AnchorRecipe(steps=600, stretch=2.2, learning_rate=2e-3)
PREFIX = "short_"
LENGTHS = (2, 3, 4, 6, 8)
NOTE = """
## Histories

Layers for people seen for fewer than 8 steps, trained after all else by
`python -m studies.histories`: {steps} steps on the same windows, seed {seed}; what is forecast
after 8 steps stayed.
"""


def first_layers(trunk: Any, initial: Any) -> Any:
    """Parameters to begin with: the layers for complete histories, which ignore the mask."""
    begun = {}
    for name, layer in initial.items():
        whole = trunk[name.removeprefix(PREFIX)]
        kernel = jnp.zeros_like(layer["kernel"])
        kernel = kernel.at[: len(whole["kernel"])].set(whole["kernel"])
        begun[name] = {"kernel": kernel, "bias": jnp.asarray(whole["bias"])}
    return begun


def with_histories(model: Model, windows: Windows, recipe: AnchorRecipe) -> Model:
    """`model` with layers for incomplete histories, trained on `windows`."""
    config = dataclasses.replace(model.config, short=True)
    forecaster = type(model.forecaster)(config)
    first, key = jax.random.split(jax.random.key(recipe.seed))
    initial = layers_of(forecaster.init(first)["params"], PREFIX)
    layers = first_layers(model.params["params"], initial)

    def loss(params: Any, batch: Any, key: Array) -> Array:
        return forecaster.loss(params, batch, key, recipe)[0]

    learning = Learning(windows, recipe, key)
    return with_layers(model, config, layers, loss, learning)


def train(
    data: tyro.conf.Positional[Path],
    hermes: tyro.conf.Positional[Path],
    out: tyro.conf.Positional[Path],
    names: tyro.conf.Positional[tuple[str, ...]] = (),
    seed: int = 0,
    steps: int = RECIPE.steps,
) -> None:
    """Write the models `names`, by default all that ship."""
    recipe = dataclasses.replace(RECIPE, seed=seed, steps=steps)
    note = NOTE.format(steps=steps, seed=seed)
    write_models(Folders(data, hermes, out), names, with_histories, recipe, note)


def cut_histories(windows: Windows, steps: int) -> Windows:
    """The same windows, of which the last `steps` observed steps were seen."""
    first = windows.obs_len - steps
    position = windows.position[:, first:]
    return dataclasses.replace(windows, position=position, obs_len=steps)


def measure(
    data: tyro.conf.Positional[Path], out: tyro.conf.Positional[Path], skip: int = 1
) -> None:
    """Print a line for each network of OUT that left a data set out, and each history."""
    writer = csv.writer(sys.stdout, lineterminator="\n")
    head = ("dataset", "pred_len", "history", "energy score", "joint ADE", "joint FDE")
    writer.writerow((*head, "energy score, constant velocity, sampled"))
    source = open_source(data)
    metrics = ("energy_score", "joint_ade", "joint_fde")
    options: Any = {"samples": 20, "seed": 0, "metrics": metrics}
    for path in sorted(out.glob("anchors_*")):
        model = load_model(path)
        if model.dataset not in source.scenes:
            continue
        config = model.config
        windows = cut_windows(
            source.recordings(model.dataset), config.obs_len, config.pred_len, skip=skip
        )
        for steps in LENGTHS:
            batches = make_batches(cut_histories(windows, steps))
            ours = score_forecaster(model.forecaster, model.params, batches, **options)
            baseline: Any = ConstantVelocitySampled(config)
            theirs = score_forecaster(baseline, {}, batches, **options)
            values = [ours.mean(name) for name in metrics]
            values.append(theirs.mean("energy_score"))
            numbers = [f"{value:.3f}" for value in values]
            writer.writerow([model.dataset, config.pred_len, steps, *numbers])
            sys.stdout.flush()


if __name__ == "__main__":
    tune()
    enable_compilation_cache()
    tyro.extras.subcommand_cli_from_dict(
        {"train": train, "test": measure}, prog="python -m studies.histories"
    )
