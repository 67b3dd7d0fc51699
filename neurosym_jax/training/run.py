"""A training run: what is trained on what, its start, steps, record to resume it by, and card.

Everything random follows from (seed, step).
"""

import dataclasses
import hashlib
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import jax
import numpy as np
from jax import Array

from neurosym_jax.configuration import from_json, to_json
from neurosym_jax.data.sources import GENERAL, Synthetic
from neurosym_jax.data.windows import Windows
from neurosym_jax.evaluation.markdown import markdown_table
from neurosym_jax.evaluation.summary import rows_frame
from neurosym_jax.evaluation.tables import format_table
from neurosym_jax.forecasting.forecasters import FORECASTERS
from neurosym_jax.forecasting.model import Model
from neurosym_jax.runtime.process import COMPILED_QUICKLY, run_environment
from neurosym_jax.training.anchors import AnchorStream, anchor_step
from neurosym_jax.training.recipe import AnchorRecipe, refuse_other_recipe
from neurosym_jax.training.step import TrainState, initial_state, new_state, train_steps
from neurosym_jax.training.stream import SceneStream

__all__ = ["ROUND", "Advance", "Run", "model_card", "record_of", "rounds_of", "start_of"]

ROUND = 25
"""Most steps between two updates of the progress bar."""

CARD = """\
# {title}

Forecasts {pred_len} steps from {obs_len} observed ones. `neurosym_jax.load_model` reads this folder, and `python evaluate.py --checkpoint` tests it.

## Errors

Best of k forecasts, metres. Joint: the best forecast of the whole scene (SGAN's protocol); marginal: each agent's own best. The two are not comparable.

Validation chose step {step}: joint ADE {val_ade:.3f}, FDE {val_fde:.3f}, best of {samples}.

{tests}

## Training

{settings}
"""  # noqa: E501
"""The text of `README.md` beside the parameters."""

Advance = Callable[[TrainState, int, int], tuple[TrainState, Mapping[str, Any]]]
"""`(state, done, count) -> (state, metrics [count])`: `count` steps after `done` ones."""


@dataclasses.dataclass(frozen=True, eq=False)
class Run:
    """What is trained on what."""

    network: Any
    """The configuration of a generator, an anchors network or an anchor table."""
    recipe: Any
    """A `Recipe` for it."""
    training: Windows
    validation: Windows
    dataset: str | None = None
    """The data set that was left out, to be tested on; recorded with the model."""
    data: tuple[str, ...] = ()
    """Names of the data sets learned from."""
    options: str = ""
    """The file of options that repeats it, in YAML; empty where no command made it."""

    def __post_init__(self):
        """Refuse a recipe of another kind of network."""
        refuse_other_recipe(self.network, self.recipe)

    @property
    def kind(self) -> str:
        """The name of the forecaster that is trained."""
        return next(kind for kind, of in FORECASTERS.items() if of.Config is type(self.network))

    @property
    def samples(self) -> int:
        """Number of samples of which validation takes the best."""
        return self.recipe.best_k if self.kind == "generator" else self.network.samples


def start_of(run: Run) -> TrainState:
    """The state before training."""
    network, recipe = run.network, run.recipe

    def start(key: Array) -> TrainState:
        if isinstance(recipe, AnchorRecipe):
            return new_state(recipe, FORECASTERS[run.kind](network).initial(key))
        return initial_state(network, recipe, key)

    return jax.jit(start, compiler_options=COMPILED_QUICKLY)(_key(run, 0))


def rounds_of(run: Run) -> Advance:
    """The function that trains `run` by a round; it may reuse the buffers of the state."""
    network, recipe, key = run.network, run.recipe, _key(run, 1)
    if isinstance(recipe, AnchorRecipe):
        anchors = AnchorStream(run.training, recipe)

        def advance(state: TrainState, done: int, count: int):
            losses = []
            for step in range(done, done + count):
                state, loss = anchor_step(network, recipe, key, state, *anchors.batch(step))
                losses.append(loss)
            # NumPy makes another error of an interruption while it looks at arrays of JAX.
            return state, {"loss": np.array(jax.device_get(losses))}

        return advance
    stream = SceneStream(run.training, recipe.batch_scenes, recipe.seed, recipe.max_agents)
    # Each step of a network has a batch of its own.
    each = 1 + recipe.discriminator_steps if recipe.adversarial_weight else 1

    def advance_generator(state: TrainState, done: int, count: int):
        groups = jax.tree.map(
            lambda leaf: leaf.reshape(count, each, *leaf.shape[1:]),
            stream.steps(done * each, count * each),
        )
        return train_steps(network, recipe, key, state, groups)

    return advance_generator


def _key(run: Run, part: int) -> Array:
    return jax.random.fold_in(jax.random.key(run.recipe.seed), part)


def record_of(run: Run) -> dict[str, Any]:
    """What must be equal for a run to be resumed with the same bits; JSON-able."""
    return {
        "forecaster": run.kind,
        "network": to_json(run.network),
        "training": to_json(run.recipe),
        "scene": run.dataset,
        "data": {"training": _digest(run.training), "validation": _digest(run.validation)},
        "environment": run_environment(),
    }


def _digest(windows: Windows) -> str:
    """SHA-256 of the windows themselves, whatever files they came from."""
    sha = hashlib.sha256()
    for array in (windows.position, windows.bounds, windows.identity):
        sha.update(np.ascontiguousarray(array).tobytes())
    return sha.hexdigest()


def model_card(facts: Mapping[str, Any], test_rows: Sequence[dict[str, Any]] = ()) -> str:
    """The text of the card of a model.

    Args:
        facts: the content of `run.json` of its training, see `loop`.
        test_rows: rows of an evaluation of this model on its own test set, and of the baselines.
    """
    kind, licences = facts["forecaster"], facts["licences"]
    network = from_json(FORECASTERS[kind].Config, dict(facts["network"]), "run.json")
    title = Model(network, {}, kind=kind).name
    if licences:
        title += f", trained on {', '.join(licences)}"
    if facts["scene"] not in (None, GENERAL) and Synthetic.name not in licences:
        title += f" without {facts['scene']}"
    settings = {
        f"{name} windows": f"{count['scenes']} scenes, {count['agents']} agents, "
        f"SHA-256 `{facts['data'][name][:16]}`"
        for name, count in facts["counts"].items()
    }
    settings["learned from"] = ", ".join(f"{name} ({of})" for name, of in licences.items())
    settings |= {name: facts[name] for name in ("parameters", "code")}
    settings["plugins"] = ", ".join(facts["plugins"])
    if (share := facts["validation"].get("val_neighbour_share")) is not None:
        settings["people whom their neighbours change"] = f"{100 * share:.1f} %, in validation"
    for section, prefix in (("training", ""), ("network", "network: "), ("environment", "")):
        settings |= {f"{prefix}{name}": value for name, value in facts[section].items()}
    known = [[name, str(value)] for name, value in settings.items() if value not in (None, "")]
    return CARD.format(
        title=title,
        obs_len=network.obs_len,
        pred_len=network.pred_len,
        samples=facts["samples"],
        **{name: facts["validation"][name] for name in ("step", "val_ade", "val_fde")},
        tests=format_table(rows_frame(test_rows), "markdown") if test_rows else "Not tested yet.",
        settings=markdown_table(["", ""], known),
    )
