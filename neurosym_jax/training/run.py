"""A training run: what is trained on what, its first state, record to resume it by, and card.

Everything random follows from (seed, step).
"""

import dataclasses
import functools
import hashlib
import json
import sys
import types
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from neurosym_jax.configuration import from_json, to_json
from neurosym_jax.data.recordings import GENERAL, Synthetic
from neurosym_jax.data.windows import Windows
from neurosym_jax.errors import InputError
from neurosym_jax.evaluation.markdown import markdown_table
from neurosym_jax.evaluation.summary import rows_frame
from neurosym_jax.evaluation.tables import format_table
from neurosym_jax.forecasting.forecaster import FORECASTERS, Forecaster, forecaster_of
from neurosym_jax.forecasting.model import Model
from neurosym_jax.runtime.process import COMPILED_QUICKLY, run_environment
from neurosym_jax.training.catalogue import refuse_other_recipe
from neurosym_jax.training.state import TrainState, warmup_of

__all__ = [
    "ROUND",
    "Run",
    "differences_between",
    "model_card",
    "record_of",
    "refuse_other_run",
]

ROUND = 25
"""Most steps between two updates of the progress bar."""

SLOWER = 10
"""By what the learning rate is divided once numbers are not finite."""
EXTENDED = {"steps", "patience"}
"""What of the recipe may be changed on resumption."""
RESULTS = ("forecaster", "config", "training", "scene", "init", "data")
"""What of a record makes the results of a run."""

CARD = """\
# {title}

Forecasts {pred_len} steps from {obs_len} observed ones. `neurosym_jax.load_model` reads this folder, and `neurosym evaluate --checkpoint` tests it.

## Errors

Best of k forecasts, metres. Joint: the best forecast of the whole scene (SGAN's protocol); marginal: each agent's own best. The two are not comparable.

Validation chose step {step}: joint ADE {val_ade:.3f}, FDE {val_fde:.3f}, best of {samples}.

{tests}

## Training

{settings}
"""
"""The text of `README.md` beside the parameters."""


@dataclasses.dataclass(frozen=True, eq=False)
class Run:
    """What is trained on what."""

    config: Any
    """The configuration of what is trained."""
    recipe: Any
    """A `Recipe` that fits it."""
    training: Windows
    validation: Windows
    dataset: str | None = None
    """The data set that was left out, to be tested on; recorded with the model."""
    data: tuple[str, ...] = ()
    """Names of the data sets learned from."""
    options: str = ""
    """The file of options that repeats it, in YAML; empty where no command made it."""
    init: Model | None = None
    """The model whose parameters it starts from; None for new ones."""

    def __post_init__(self):
        """Refuse a recipe of another kind of network, and what does not fit the initial model."""
        refuse_other_recipe(self.forecaster, self.recipe)
        if self.init is None and not self.recipe.steps:
            raise InputError("steps must be at least 1 without an initial model")
        if self.init is not None and self.init.config != self.config:
            before, now = (
                to_json(config) for config in (self.init.config, self.config)
            )
            changes = "; ".join(differences_between(before, now))
            raise InputError(f"the initial model has another configuration: {changes}")
        modules = self.forecaster.shapes()
        paths = (path for path, _ in jax.tree.leaves_with_path(modules))
        known = {getattr(entry, "key", None) for path in paths for entry in path}
        if unknown := [name for name in self.recipe.freeze if name not in known]:
            there = ", ".join(modules.get("params", modules))
            raise InputError(f"freeze: no module {unknown[0]!r} in {there}")

    @property
    def forecaster(self) -> Forecaster:
        """What is trained."""
        return forecaster_of(self.config)

    @property
    def samples(self) -> int:
        """Number of samples of which validation takes the best."""
        return self.forecaster.best_of(self.recipe)

    def init_state(self) -> TrainState:
        """The state before training."""
        init = functools.partial(self.forecaster.init_state, self.recipe)
        state = jax.jit(init, compiler_options=COMPILED_QUICKLY)(self._key(0))
        if self.init is None:
            return state
        params, average = (jax.tree.map(jnp.array, self.init.params) for _ in range(2))
        return state._replace(params=params, average=average if self.recipe.ema else ())

    def slower(self) -> "Run":
        """The run with smaller steps, after one whose numbers were not finite."""
        rates = {
            name: getattr(self.recipe, name) / SLOWER
            for name in ("learning_rate", "d_learning_rate")
            if hasattr(self.recipe, name)
        }
        return dataclasses.replace(
            self, recipe=dataclasses.replace(self.recipe, **rates)
        )

    def rounds(
        self,
    ) -> Callable[[TrainState, int, int], tuple[TrainState, Mapping[str, Any]]]:
        """See `Forecaster.rounds`."""
        return self.forecaster.rounds(self.training, self.recipe, self._key(1))

    def _key(self, part: int) -> Array:
        return jax.random.fold_in(jax.random.key(self.recipe.seed), part)


def record_of(run: Run) -> dict[str, Any]:
    """What must be equal for a run to be resumed with the same bits; JSON-able."""
    return {
        "forecaster": run.forecaster.key,
        "config": to_json(run.config),
        "training": to_json(run.recipe),
        "scene": run.dataset,
        "init": None
        if run.init is None
        else _digest_of(*jax.tree.leaves(run.init.params)),
        "data": {
            "training": _digest(run.training),
            "validation": _digest(run.validation),
        },
        "environment": run_environment(),
    }


def refuse_other_run(
    before: dict[str, Any], record: dict[str, Any], done: int, folder: Path
) -> None:
    """Refuse to resume a run that differs in what makes its results; tell what changes bits.

    More steps, and another patience, are no other run.

    Raises:
        InputError: naming all that differs.
    """
    record = json.loads(json.dumps(record))
    then, now = before["training"]["steps"], record["training"]["steps"]
    other = sorted(differences_between(_fixed(before), _fixed(record)))
    if now < done:
        other.append(f"training.steps {now}, and {done} are done")
    if other:
        raise InputError(f"{folder}: holds another run: {'; '.join(other)}")
    environment = differences_between(before["environment"], record["environment"])
    changes = [f"goes on with {text}" for text in environment]
    if then != now and record["training"]["schedule"] != "constant":
        changes += [
            f"was scheduled for {then} steps, and from step {done} on follows the schedule of {now}"
        ]
    for text in changes:
        print(
            f"warning: {folder}: the run {text}: other bits than in one go",
            file=sys.stderr,
        )


def _fixed(record: dict[str, Any]) -> dict[str, Any]:
    """What of a record no resumption may change."""
    recipe = {name: x for name, x in record["training"].items() if name not in EXTENDED}
    return {name: record[name] for name in RESULTS} | {"training": recipe}


def differences_between(before: Any, now: Any, name: str = "") -> Iterator[str]:
    """`NAME VALUE (now VALUE)` of each value that differs, of dictionaries by their keys."""
    if isinstance(before, dict) and isinstance(now, dict):
        for key in [*before, *(key for key in now if key not in before)]:
            path = f"{name}.{key}" if name else key
            yield from differences_between(before.get(key), now.get(key), path)
    elif before != now:
        short = [str(value)[:40] for value in (before, now)]
        yield f"{name} {short[0]} (now {short[1]})"


def _digest(windows: Windows) -> str:
    """SHA-256 of the windows themselves, whatever files they came from."""
    return _digest_of(windows.position, windows.bounds, windows.identity)


def _digest_of(*arrays: Any) -> str:
    sha = hashlib.sha256()
    for array in arrays:
        sha.update(np.ascontiguousarray(array).tobytes())
    return sha.hexdigest()


def model_card(
    facts: Mapping[str, Any], test_rows: Sequence[dict[str, Any]] = ()
) -> str:
    """The text of the card of a model.

    Args: facts: the content of `run.json` of its training, see `loop`. test_rows: rows
        of an evaluation of this model on its own test set, and of the baselines.
    """
    family, licences = FORECASTERS[facts["forecaster"]], facts["licences"]
    config = from_json(family.Config, dict(facts["config"]), "run.json")
    title = family(config).title
    if licences:
        title += f", trained on {', '.join(licences)}"
    if facts["scene"] not in (None, GENERAL) and Synthetic.name not in licences:
        title += f" without {facts['scene']}"
    settings = {
        f"{name} windows": f"{count['scenes']} scenes, {count['agents']} agents, "
        f"SHA-256 `{facts['data'][name][:16]}`"
        for name, count in facts["counts"].items()
    }
    settings["learned from"] = ", ".join(
        f"{name} ({licence})" for name, licence in licences.items()
    )
    settings |= {name: facts[name] for name in ("parameters", "code")}
    settings["plugins"] = ", ".join(facts["plugins"])
    if (share := facts["validation"].get("val_neighbour_share")) is not None:
        settings["people whom their neighbours change"] = (
            f"{100 * share:.1f} %, in validation"
        )
    for section, prefix in (
        ("training", ""),
        ("config", "config: "),
        ("environment", ""),
    ):
        settings |= {f"{prefix}{name}": value for name, value in facts[section].items()}
    settings["warmup_steps"] = str(
        warmup_of(types.SimpleNamespace(**facts["training"]))
    )
    lines = [
        [name, str(value)]
        for name, value in settings.items()
        if value not in (None, "", [])
    ]
    return CARD.format(
        title=title,
        obs_len=config.obs_len,
        pred_len=config.pred_len,
        samples=facts["samples"],
        **{name: facts["validation"][name] for name in ("step", "val_ade", "val_fde")},
        tests=format_table(rows_frame(test_rows), "markdown")
        if test_rows
        else "Not tested yet.",
        settings=markdown_table(["", ""], lines),
    )
