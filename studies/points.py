"""The distribution of the `anchors` networks that ship: points, trained on networks that stay.

NPROC=1 python -m studies.points DATA HERMES OUT [NAME ...] [--seed N] [--steps N]

writes OUT/NAME of checkpoints/anchors_*, by default of all.

DATA is ETH/UCY as SGAN arranges it, HERMES the folder `hermes` of `studies.more_data`,
from which the general networks learned, too. A network's other parameters stay as they
are, and so do its samples, bit by bit: points are a further output of the same trunk.
Nothing is chosen by a validation: the averaged parameters of the last step are kept.
Finished networks are not repeated.
"""

import dataclasses
import functools
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import tyro
from jax import Array

from neurosym_jax.data.recordings import GENERAL, recordings_in, split_files
from neurosym_jax.data.windows import Windows, cut_windows
from neurosym_jax.models.anchors.forecaster import apply_anchors
from neurosym_jax.models.anchors.loss import AnchorStream, company, points_loss
from neurosym_jax.models.anchors.recipe import AnchorRecipe
from neurosym_jax.models.disk import CARD, load_model, save_model
from neurosym_jax.models.forecast import Model
from neurosym_jax.runtime.process import enable_compilation_cache, tune
from neurosym_jax.training.batches import augment
from neurosym_jax.training.state import TrainState, new_state, update

CHECKPOINTS = Path(__file__).resolve().parents[1] / "checkpoints"
RECIPE = AnchorRecipe(steps=600, stretch=2.2)
POINTS, PREFIX = 32, "point_"
NOTE = """
## Distribution

{points} points of each person, trained after all else by `python -m studies.points`: {steps} steps
on the same windows, seed {seed}, stretch {stretch}; the other parameters and the samples stayed.
"""


def learned_windows(data: Path, hermes: Path, model: Model) -> Windows:
    """The windows that `model` learned from."""
    general = model.dataset == GENERAL
    files = split_files(data, None if general else model.dataset, "train")
    files += sorted(hermes.glob("*.txt")) if general else []
    lengths = model.config.obs_len, model.config.pred_len
    return cut_windows(
        recordings_in(map(str, files)), *lengths, min_agents=RECIPE.min_agents
    )


def points_of(params: Any) -> Any:
    """The parameters of the points among those of a network."""
    return {name: value for name, value in params.items() if name.startswith(PREFIX)}


@functools.partial(jax.jit, static_argnums=(0, 1))
def step(
    config: Any,
    recipe: AnchorRecipe,
    trunk: Any,
    key: Array,
    state: TrainState,
    batch: Any,
) -> tuple[TrainState, Array]:
    """The state of the points after one step on a batch of `AnchorStream`, and its loss []."""
    scenes, crowd = batch
    (scenes,) = augment((scenes,), jax.random.fold_in(key, state.step), recipe)
    scenes = jax.tree.map(jnp.asarray, scenes)
    crowd_people = company(scenes.valid, crowd)

    def loss(points: Any) -> Array:
        params = {"params": {**trunk, **points}}
        apply = functools.partial(apply_anchors, config, params)
        forecast = jax.vmap(apply)(scenes.replace(future=None), crowd_people)
        total = points_loss(forecast.points, scenes.known_future, scenes.valid, recipe)
        return total / scenes.valid.sum()

    value, gradient = jax.value_and_grad(loss)(state.params)
    return update(recipe, state, gradient), value


def with_points(model: Model, windows: Windows, recipe: AnchorRecipe) -> Model:
    """`model` with points, trained on `windows`."""
    forecaster = model.forecaster
    forecaster = type(forecaster)(dataclasses.replace(model.config, points=POINTS))
    first, key = jax.random.split(jax.random.key(recipe.seed))
    state = new_state(recipe, points_of(forecaster.init(first)["params"]))
    batch = AnchorStream(windows, recipe).batch
    for number in range(recipe.steps):
        trunk = model.params["params"]
        state, value = step(forecaster.config, recipe, trunk, key, state, batch(number))
        if (number + 1) % 100 == 0:
            print(f"  step {number + 1}: {float(value):.3f}", flush=True)
    params = {"params": {**model.params["params"], **jax.device_get(state.average)}}
    return dataclasses.replace(model, config=forecaster.config, params=params)


def main(
    data: tyro.conf.Positional[Path],
    hermes: tyro.conf.Positional[Path],
    out: tyro.conf.Positional[Path],
    names: tyro.conf.Positional[tuple[str, ...]] = (),
    seed: int = 0,
    steps: int = RECIPE.steps,
) -> None:
    """Write the models `names`, by default all that ship."""
    recipe = dataclasses.replace(RECIPE, seed=seed, steps=steps)
    for name in names or sorted(path.name for path in CHECKPOINTS.glob("anchors_*")):
        if (out / name).exists():
            continue
        print(name, flush=True)
        model = load_model(CHECKPOINTS / name)
        changed = with_points(model, learned_windows(data, hermes, model), recipe)
        card = (
            (CHECKPOINTS / name / CARD)
            .read_text(encoding="utf-8")
            .split("\n## Distribution")[0]
        )
        note = {name: getattr(recipe, name) for name in ("steps", "seed", "stretch")}
        save_model(
            out / name,
            changed,
            card.rstrip() + "\n" + NOTE.format(points=POINTS, **note),
        )


if __name__ == "__main__":
    tune()
    enable_compilation_cache()
    tyro.cli(main, prog="python -m studies.points")
