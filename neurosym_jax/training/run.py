"""What a run is and keeps: its recipe and configuration by name, its identity, its
validation, and the files of its folder.
"""

import dataclasses
import functools
import json
import sys
import types
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from neurosym_jax.configuration import changed, from_json, refuse, to_json
from neurosym_jax.data.recordings import GENERAL, Synthetic, licences_of
from neurosym_jax.data.windows import Batch, Windows, fingerprint, merged_fingerprints
from neurosym_jax.errors import InputError
from neurosym_jax.evaluation.scores import score_forecaster
from neurosym_jax.evaluation.tables import (
    format_table,
    markdown_table,
    markdown_text,
    rows_frame,
)
from neurosym_jax.models.disk import save_model
from neurosym_jax.models.forecast import Model, digest_of
from neurosym_jax.models.forecaster import FORECASTERS, Forecaster, forecaster_of
from neurosym_jax.plugins import loaded, names
from neurosym_jax.runtime.files import append_text, write_json, write_text
from neurosym_jax.runtime.process import COMPILED_QUICKLY, code_version, run_environment
from neurosym_jax.training.custom import Custom
from neurosym_jax.training.recipe import Recipe
from neurosym_jax.training.state import TrainState, warmup_of, with_schedule

__all__ = [
    "ROUND",
    "Advice",
    "Row",
    "Run",
    "RunFiles",
    "best_row",
    "differences_between",
    "is_over",
    "known_configs",
    "known_recipes",
    "make_config",
    "make_recipe",
    "model_card",
    "recipes_of",
    "record_of",
    "refuse_other_recipe",
    "refuse_other_run",
    "usual_recipe",
    "validate",
]


# The recipes and configurations of all families that learn, by name.


def make_recipe(
    name: str, *, seed: int = 0, steps: int | None = None, changes: Sequence[str] = ()
) -> Recipe:
    """The recipe of this name; `changes` are NAME=VALUE, a value as JSON or as text.

    Raises:
        InputError: for an unknown name, a change that is not NAME=VALUE of a field, or
            a value out of its range.
    """
    recipes = known_recipes()
    refuse(Literal[*recipes], {"recipe": name})
    length = [] if steps is None else [f"steps={steps}"]
    return changed(
        recipes[name], [f"seed={seed}", *length, *changes], "set", f"recipe {name}"
    )


def make_config(
    family: str = "sgan",
    *,
    obs_len: int = 8,
    pred_len: int = 8,
    period: float = 0.4,
    changes: Sequence[str] = (),
) -> Any:
    """The configuration of a family: `sgan`, `neurosym`, `anchors`, or a plugin's.

    Args:
        family: its name.
        obs_len: observed steps.
        pred_len: steps to forecast.
        period: seconds between steps.
        changes: of the published sizes, each NAME=VALUE of a field of the
            configuration, such as `pooling=social` or `weighting=cnd`.

    Raises:
        InputError: for an unknown family, a change that does not fit, or one that
            makes it another family.
    """
    configs = known_configs()
    refuse(Literal[*configs], {"family": family})
    lengths = {"obs_len": obs_len, "pred_len": pred_len, "period": period}
    config = changed(
        dataclasses.replace(configs[family], **lengths), changes, "config", family
    )
    other = forecaster_of(config).model
    if other != family:
        raise InputError(f"family {family!r}: {', '.join(changes)} makes it {other!r}")
    return config


def recipes_of(family: type[Forecaster]) -> dict[str, Recipe]:
    """A family's recipes by name, the usual one first."""
    return {**family.recipes} or {FORECASTERS.name_of(family): Recipe()}


def usual_recipe(config: Any) -> Recipe:
    """The usual recipe of what a configuration makes."""
    recipes = recipes_of(type(forecaster_of(config)))
    return next(iter(recipes.values()))


def known_recipes() -> dict[str, Recipe]:
    """The recipes of all families that learn, by name."""
    recipes = {}
    for family in _learners():
        recipes |= recipes_of(family)
    return recipes


def known_configs() -> dict[str, Any]:
    """The configurations of all models that learn, by name."""
    configs: dict[str, Any] = {}
    for family in _learners():
        # A subclass inherits the names of another's models; its own is its key.
        own = family.configs if "configs" in vars(family) else {}
        configs |= own or {FORECASTERS.name_of(family): family.Config()}
    return configs


def refuse_other_recipe(forecaster: Forecaster, recipe: Any) -> None:
    """Refuse a recipe of another kind of network, and a forecaster that learns nothing.

    Raises:
        InputError: naming the recipes that fit.
    """
    if type(forecaster) not in _learners():
        raise InputError(f"{forecaster.title} has nothing to train")
    fitting = recipes_of(type(forecaster))
    if type(recipe) not in map(type, fitting.values()):
        raise InputError(
            f"recipe: does not fit {forecaster.model}, which takes {[*fitting]}"
        )


def _learners() -> list[type[Forecaster]]:
    return [
        family for family in FORECASTERS.values() if family.init is not Forecaster.init
    ]


# A training run: what is trained on what, its first state, record to resume it by, and
# card.
#
# Everything random follows from (seed, step).

ROUND = 25
"""Most steps between two updates of the progress bar."""

SLOWER = 10
"""By what the learning rate is divided once numbers are not finite."""
EXTENDED = {"steps", "patience"}
"""What of the recipe may be changed on resumption."""
OLD_NAMES = {"model": "family"}
"""Options of `neurosym train` by the names that they had in the last release."""
Record = dict[str, Any]
"""What a run is, for JSON, see `record_of`."""
RESULTS = ("forecaster", "config", "training", "scene", "init", "data")
"""What of a record makes the results of a run."""

CARD = """\
# {title}

Forecasts {pred_len} steps from {obs_len} observed ones. `neurosym_jax.load_model` reads this folder, and `neurosym evaluate --model` tests it.

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
    custom: Custom = Custom()  # noqa: RUF009 (frozen)
    """A loss, an optimiser and schedules in place of the recipe's."""

    def __post_init__(self):
        """Refuse a recipe of another kind of network, and what does not fit the initial model."""
        refuse_other_recipe(self.forecaster, self.recipe)
        if self.init is None and not self.recipe.steps:
            raise InputError("steps must be at least 1 without an initial model")
        if self.init is not None and self.init.config != self.config:
            before = to_json(self.init.config)
            changes = "; ".join(differences_between(before, to_json(self.config)))
            raise InputError(f"the initial model has another configuration: {changes}")
        modules = self.forecaster.shapes()
        module_names = set()
        for path, _ in jax.tree.leaves_with_path(modules):
            module_names.update(getattr(entry, "key", None) for entry in path)
        for name in self.recipe.freeze:
            if name not in module_names:
                names = ", ".join(modules.get("params", modules))
                raise InputError(f"freeze: no module {name!r} in {names}")

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
        recipe = self.custom.recipe(self.recipe)
        init = functools.partial(self.forecaster.init_state, recipe)
        state = jax.jit(init, compiler_options=COMPILED_QUICKLY)(self._key(0))
        params = state.params if self.init is None else self.init.params
        if self.init is None and not recipe.scheduled():
            return state
        params = with_schedule(recipe, params, 0)
        average = jax.tree.map(jnp.array, params) if recipe.ema else ()
        own_params = jax.tree.map(jnp.array, params)
        return state._replace(params=own_params, average=average)

    def slower(self) -> "Run":
        """The run with smaller steps, after one whose numbers were not finite."""
        rates = {}
        for name in ("learning_rate", "d_learning_rate"):
            if hasattr(self.recipe, name):
                rates[name] = getattr(self.recipe, name) / SLOWER
        recipe = dataclasses.replace(self.recipe, **rates)
        return dataclasses.replace(self, recipe=recipe)

    def rounds(
        self,
    ) -> Callable[[TrainState, int, int], tuple[TrainState, Mapping[str, Any]]]:
        """See `Forecaster.rounds`."""
        forecaster = self.custom.forecaster(self.forecaster)
        recipe = self.custom.recipe(self.recipe)
        advance = forecaster.rounds(self.training, recipe, self._key(1))

        def checked(state: TrainState, done: int, count: int) -> Any:
            result = advance(state, done, count)
            self.custom.refuse_unheard(forecaster)
            return result

        return checked

    def _key(self, part: int) -> Array:
        return jax.random.fold_in(jax.random.key(self.recipe.seed), part)


def record_of(run: Run) -> Record:
    """What must be equal for a run to be resumed with the same bits; JSON-able."""
    init = None
    if run.init is not None:
        leaves = jax.tree.leaves(run.init.params)
        init = digest_of(*map(np.ascontiguousarray, leaves))
    return {
        "forecaster": run.forecaster.key,
        "config": to_json(run.config),
        "training": to_json(run.recipe),
        "scene": run.dataset,
        "init": init,
        "data": {
            "training": _digest(run.training),
            "validation": _digest(run.validation),
        },
        "custom": run.custom.facts(),
        "environment": run_environment(),
    }


def refuse_other_run(before: Record, record: Record, done: int, folder: Path) -> None:
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


def _fixed(record: Record) -> Record:
    """What of a record no resumption may change."""
    recipe = {name: x for name, x in record["training"].items() if name not in EXTENDED}
    fixed = {name: record[name] for name in RESULTS} | {"training": recipe}
    # Records of earlier versions have no "custom".
    return fixed | {"custom": record.get("custom", {})}


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
    parts = windows.position, windows.bounds, windows.identity
    return digest_of(*map(np.ascontiguousarray, parts))


def model_card(
    facts: Mapping[str, Any], test_rows: Sequence[dict[str, Any]] = ()
) -> str:
    """The text of the card of a model.

    Args:
        facts: the content of `run.json` of its training, see `loop`.
        test_rows: rows of an evaluation of this model on its own test set, and of the
            baselines.
    """
    family, licences = FORECASTERS[facts["forecaster"]], facts["licences"]
    config = from_json(family.Config, dict(facts["config"]), "run.json")
    title = family(config).title
    if licences:
        title += f", trained on {', '.join(licences)}"
    if facts["scene"] not in (None, GENERAL) and Synthetic.name not in licences:
        title += f" without {facts['scene']}"
    lines = []
    for name, value in _settings_of(facts).items():
        if value not in (None, "", []):
            lines.append([name, markdown_text(str(value))])
    tests = "Not tested yet."
    if test_rows:
        tests = format_table(rows_frame(test_rows), "markdown")
    return CARD.format(
        title=title,
        obs_len=config.obs_len,
        pred_len=config.pred_len,
        samples=facts["samples"],
        **{name: facts["validation"][name] for name in ("step", "val_ade", "val_fde")},
        tests=tests,
        settings=markdown_table(["", ""], lines),
    )


# Validation: errors on windows that nothing is learned from, the best row, and advice.

Row = dict[str, Any]
"""A line of `metrics.jsonl`: the step, metrics of training and, where it was validated, `val_...`.
"""

ERRORS = ("joint_ade", "joint_fde", "energy_score", "coverage_50")
EFFECT = ("neighbour_share", "neighbour_near", "neighbour_move")
"""The metrics of a validation by which a pooling is judged."""
LEAST = 0.5
"""Least share of people with somebody within 2 m whom a living pooling changes."""


def _settings_of(facts: Mapping[str, Any]) -> dict[str, Any]:
    """What a card lists of a training, by name."""
    settings = {}
    for name, count in facts["counts"].items():
        digest = facts["data"][name][:16]
        people = f"{count['scenes']} scenes, {count['agents']} agents"
        settings[f"{name} windows"] = f"{people}, SHA-256 {digest}"
    licences = [f"{name} ({licence})" for name, licence in facts["licences"].items()]
    settings["learned from"] = ", ".join(licences)
    settings["parameters"] = facts["parameters"]
    settings["code"] = facts["code"]
    settings["plugins"] = ", ".join(facts["plugins"])
    share = facts["validation"].get("val_neighbour_share")
    if share is not None:
        text = f"{100 * share:.1f} %, in validation"
        settings["people whom their neighbours change"] = text
    settings |= facts.get("custom", {})
    settings |= facts["training"]
    for name, value in facts["config"].items():
        settings[f"config: {name}"] = value
    settings |= facts["environment"]
    recipe = types.SimpleNamespace(**facts["training"])
    settings["warmup_steps"] = str(warmup_of(recipe))
    return settings


FEW = 100
"""Fewer people than these make a validation error that says little."""
STALLED = 5
"""Validations in a row without a better one, after which that is told."""


def validate(run: Run, params: Any, batches: Sequence[Batch]) -> Row:
    """Errors on the validation windows, best of k and of the distribution.

    `val_score` chooses the best state, see `Recipe.select_by`.
    """
    forecaster = run.forecaster
    metrics = ERRORS
    if forecaster.sees_neighbours:
        metrics = (*ERRORS, *EFFECT)
    result = score_forecaster(
        forecaster,
        params,
        batches,
        samples=run.samples,
        seed=run.recipe.seed,
        metrics=metrics,
    )
    means = {}
    for name in result.scores:
        means[name.removeprefix("joint_")] = result.mean(name)
    usual = "energy" if forecaster.calibrated else "ade_fde"
    parts = {"ade": ("ade",), "ade_fde": ("ade", "fde"), "energy": ("energy_score",)}
    chosen = parts[run.recipe.select_by or usual]
    row: Row = {"val_score": sum(means[name] for name in chosen)}
    for name, value in means.items():
        if name in ("ade", "fde") or np.isfinite(value):
            row[f"val_{name}"] = value
    return row


def best_row(rows: Sequence[Row]) -> Row:
    """The row of the best validation, of equals the newest; an empty one before the first."""
    validated = [row for row in rows if "val_score" in row]
    return min(reversed(validated), key=lambda row: row["val_score"], default={})


def is_over(run: Run, rows: Sequence[Row], done: int) -> bool:
    """Whether all steps are done, or patience is at its end."""
    patience = run.recipe.patience
    return done >= run.recipe.steps or (0 < patience <= _waited(rows))


def _waited(rows: Sequence[Row]) -> int:
    """Validations since the best one."""
    validated = [row for row in rows if "val_score" in row]
    if validated:
        return len(validated) - 1 - validated.index(best_row(rows))
    return 0


class Advice:
    """What a training tells in words, once each, on the standard error."""

    def __init__(self, run: Run):
        """Look at the windows that are validated on."""
        self._run, self._given = run, set[str]()
        people = run.validation.agents
        if people < FEW:
            self._give(
                f"validation has {people} people in windows: below {FEW} its errors say little, "
                "and the best state is chosen half by chance; validate on more"
            )

    def __call__(self, rows: Sequence[Row]) -> None:
        """Look at the rows so far, of which the last was validated."""
        row, recipe = rows[-1], self._run.recipe
        if row.get("val_neighbour_near", 1.0) < LEAST:
            remedy = "a third of the learning_rate and 500 warmup_steps"
            if not getattr(recipe, "gentle_pooling", True):
                remedy = f"gentle_pooling=true, or {remedy}"
            self._give(
                f"dead pooling at step {row['step']}: {row['val_neighbour_share']:.0%} of people "
                f"are changed by their neighbours; try {remedy}",
                "dead pooling",
            )
        if _waited(rows) == STALLED and not recipe.patience:
            self._give(
                f"no validation is better than that of step {best_row(rows)['step']} since; its "
                "state is kept, so end this run, or begin from it with a smaller learning_rate"
            )

    def _give(self, text: str, about: str = "") -> None:
        if (about or text) not in self._given:
            self._given.add(about or text)
            print(f"advice: {text}", file=sys.stderr)


# The files of a run: its log, the best state as a model at every moment, and facts at
# its end.
#
# A run is a folder: `recipe.yaml` (the options that repeat it), `checkpoints/` (to resume
# from), `metrics.jsonl`, `model/` (the best state by validation so far, and its card) and
# at its end `curves.png` and `run.json`, all facts of the run, whose presence says that
# it is finished.


@dataclasses.dataclass(frozen=True, eq=False)
class RunFiles:
    """The files of one run in `folder`; `record` is that of the run."""

    run: Run
    folder: Path
    record: Record

    @property
    def finished(self) -> bool:
        """Whether all is written that a finished run leaves."""
        return (self.folder / "run.json").is_file()

    def begin(self, rows: Sequence[Row]) -> None:
        """Write the options and the rows so far."""
        if self.run.options:
            write_text(self.folder / "recipe.yaml", self.run.options)
        write_text(self.folder / "metrics.jsonl", "".join(map(_line, rows)))

    def add(self, row: Row) -> None:
        """Append a row to the log."""
        append_text(self.folder / "metrics.jsonl", _line(row))

    def unfinish(self) -> None:
        """Say that the run goes on."""
        (self.folder / "run.json").unlink(missing_ok=True)

    def keep(self, params: Any, best: Row) -> None:
        """Replace the model by one with these parameters, which `best` was validated with."""
        model = self.model(params, best)
        facts = self._facts(model, best)
        save_model(self.folder / "model", model, model_card(facts), replace=True)

    def finish(self, params: Any, rows: Sequence[Row]) -> Model:
        """Write what a finished run leaves; returns the model."""
        from neurosym_jax.plotting import plot_training, save_figure

        best = best_row(rows)
        model = self.model(params, best)
        if self.finished:
            return model
        self.keep(params, best)
        losses = _curves(rows, ("loss", "g_loss", "g_adversarial", "d_loss"))
        errors = _curves(rows, ("val_ade", "val_fde", "val_energy_score"))
        figure = plot_training(losses, errors, "training", best=best["step"])
        save_figure(figure, self.folder / "curves.png")
        # Last: it says that the run is finished, whatever kills the process.
        write_json(self.folder / "run.json", self._facts(model, best))
        return model

    def model(self, params: Any, best: Row) -> Model:
        """The model with these parameters, and its origin, that of the initial model included."""
        run = self.run
        init = run.init
        data = licences_of(run.data)
        if init is not None:
            data = {**(init.data or {"the initial model's": "unstated"}), **data}
        return Model(
            run.config,
            params,
            run.dataset,
            run.forecaster.key,
            seed=run.recipe.seed,
            neighbours=best.get("val_neighbour_near"),
            seen=self._seen,
            plugins=names(loaded()),
            data=data,
            step=best["step"],
            recipe=self._recipe,
        )

    @property
    def _recipe(self) -> str:
        """`Model.recipe`: with the parameters that the training began with, if it had some."""
        recipe = to_json(dataclasses.replace(self.run.recipe, seed=0))
        contents: list[Any] = [json.dumps(recipe, sort_keys=True).encode()]
        if self.run.init is not None:
            leaves = jax.tree.leaves(self.run.init.params)
            contents += map(np.ascontiguousarray, leaves)
        return digest_of(*contents)[:16]

    @functools.cached_property
    def _seen(self) -> str:
        before = () if self.run.init is None else (self.run.init.seen,)
        return merged_fingerprints(fingerprint(self.run.training), *before)

    @functools.cached_property
    def _code(self) -> str | None:
        return code_version()

    def _facts(self, model: Model, best: Row) -> Record:
        """The content of `run.json`."""
        parts = {"training": self.run.training, "validation": self.run.validation}
        counts, recordings = {}, {}
        for name, windows in parts.items():
            counts[name] = {"scenes": windows.scenes, "agents": windows.agents}
            recordings[name] = list(map(dataclasses.asdict, windows.reading))
        return {
            **self.record,
            "samples": self.run.samples,
            "licences": model.data,
            "counts": counts,
            "recordings": recordings,
            "parameters": sum(leaf.size for leaf in jax.tree.leaves(model.params)),
            "code": self._code,
            "plugins": list(model.plugins),
            "validation": best,
        }


def _curves(rows: Sequence[Row], metrics: Iterable[str]) -> dict[str, Any]:
    """The steps and values of each metric that a row has."""
    curves = {}
    for name in metrics:
        points = [(row["step"], row[name]) for row in rows if name in row]
        if points:
            curves[name] = tuple(zip(*points))
    return curves


def _line(row: Row) -> str:
    return json.dumps(row, allow_nan=False) + "\n"
