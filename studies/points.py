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
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

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
Loss = Callable[[Any, Any, Array], Array]
"""The loss [] of all parameters on a batch; consumes its key."""
NOTE = """
## Distribution

{points} points of each person, trained after all else by `python -m studies.points`: {steps} steps
on the same windows, seed {seed}, stretch {stretch}; the other parameters and the samples stayed.
"""


class Learning(NamedTuple):
    """What layers are trained on, how, and by which random numbers."""

    windows: Windows
    recipe: AnchorRecipe
    key: Array


class Folders(NamedTuple):
    """Where data are, and where models go."""

    data: Path
    hermes: Path
    out: Path


def learned_windows(data: Path, hermes: Path, model: Model) -> Windows:
    """The windows that `model` learned from."""
    general = model.dataset == GENERAL
    files = split_files(data, None if general else model.dataset, "train")
    files += sorted(hermes.glob("*.txt")) if general else []
    lengths = model.config.obs_len, model.config.pred_len
    return cut_windows(
        recordings_in(map(str, files)), *lengths, min_agents=RECIPE.min_agents
    )


def layers_of(params: Any, prefix: str) -> Any:
    """The parameters of a network whose names begin so."""
    return {name: value for name, value in params.items() if name.startswith(prefix)}


@functools.partial(jax.jit, static_argnums=(0, 1))
def step(
    loss: Loss,
    recipe: AnchorRecipe,
    trunk: Any,
    key: Array,
    state: TrainState,
    batch: Any,
) -> tuple[TrainState, Array]:
    """The state of layers after one step on a batch of `AnchorStream`, and its loss []."""
    part = jax.random.fold_in(key, state.step)

    def of_layers(layers: Any) -> Array:
        return loss({"params": {**trunk, **layers}}, batch, part)

    value, gradient = jax.value_and_grad(of_layers)(state.params)
    return update(recipe, state, gradient), value


def with_layers(
    model: Model, config: Any, layers: Any, loss: Loss, learning: Learning
) -> Model:
    """`model` with `config` and further `layers`, trained while its parameters stay."""
    recipe, key = learning.recipe, learning.key
    state = new_state(recipe, layers)
    batch = AnchorStream(learning.windows, recipe).batch
    trunk = model.params["params"]
    for number in range(recipe.steps):
        state, value = step(loss, recipe, trunk, key, state, batch(number))
        if (number + 1) % 100 == 0:
            print(f"  step {number + 1}: {float(value):.3f}", flush=True)
    params = {"params": {**trunk, **jax.device_get(state.average)}}
    return dataclasses.replace(model, config=config, params=params)


def with_points(model: Model, windows: Windows, recipe: AnchorRecipe) -> Model:
    """`model` with points, trained on `windows`."""
    config = dataclasses.replace(model.config, points=POINTS)
    first, key = jax.random.split(jax.random.key(recipe.seed))
    initial = type(model.forecaster)(config).init(first)["params"]

    def loss(params: Any, batch: Any, key: Array) -> Array:
        scenes, crowd = batch
        (scenes,) = augment((scenes,), key, recipe)
        scenes = jax.tree.map(jnp.asarray, scenes)
        apply = functools.partial(apply_anchors, config, params)
        people = company(scenes.valid, crowd)
        forecast = jax.vmap(apply)(scenes.replace(future=None), people)
        total = points_loss(forecast.points, scenes.known_future, scenes.valid, recipe)
        return total / scenes.valid.sum()

    learning = Learning(windows, recipe, key)
    return with_layers(model, config, layers_of(initial, PREFIX), loss, learning)


def write_models(
    folders: Folders,
    names: Sequence[str],
    train: Callable[[Model, Windows, AnchorRecipe], Model],
    recipe: AnchorRecipe,
    note: str,
) -> None:
    """Write models `names`, by default all that ship, each with `note` at its card's end.

    A note begins with its heading, and replaces the one of an earlier training.
    """
    heading = note.strip().splitlines()[0]
    for name in names or sorted(path.name for path in CHECKPOINTS.glob("anchors_*")):
        if (folders.out / name).exists():
            continue
        print(name, flush=True)
        model = load_model(CHECKPOINTS / name)
        windows = learned_windows(folders.data, folders.hermes, model)
        changed = train(model, windows, recipe)
        card = (CHECKPOINTS / name / CARD).read_text(encoding="utf-8")
        card = card.split(f"\n{heading}")[0].rstrip()
        save_model(folders.out / name, changed, f"{card}\n{note}")


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
    facts = {"steps": steps, "seed": seed, "stretch": recipe.stretch}
    note = NOTE.format(points=POINTS, **facts)
    write_models(Folders(data, hermes, out), names, with_points, recipe, note)


if __name__ == "__main__":
    tune()
    enable_compilation_cache()
    tyro.cli(main, prog="python -m studies.points")
