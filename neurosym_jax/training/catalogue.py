"""The recipes and configurations of all families that learn, by name."""

import dataclasses
from collections.abc import Sequence
from typing import Any, Literal

from neurosym_jax.configuration import changed, refuse
from neurosym_jax.errors import InputError
from neurosym_jax.forecasting.forecaster import FORECASTERS, Forecaster, forecaster_of
from neurosym_jax.training.recipe import Recipe

__all__ = ["known_configs", "known_recipes", "make_config", "make_recipe", "recipes_of"]
__all__ += ["refuse_other_recipe"]


def make_recipe(
    name: str, *, seed: int = 0, steps: int | None = None, changes: Sequence[str] = ()
) -> Recipe:
    """The recipe of this name; `changes` are NAME=VALUE, a value as JSON or as text.

    Raises: InputError: for an unknown name, a change that is not NAME=VALUE of a field,
        or a value out
            of its range.
    """
    recipes = known_recipes()
    refuse(Literal[*recipes], {"recipe": name})
    length = [] if steps is None else [f"steps={steps}"]
    return changed(
        recipes[name], [f"seed={seed}", *length, *changes], "set", f"recipe {name}"
    )


def make_config(
    model: str = "sgan",
    *,
    obs_len: int = 8,
    pred_len: int = 8,
    period: float = 0.4,
    changes: Sequence[str] = (),
) -> Any:
    """The configuration of a model by name: `sgan`, `neurosym`, `anchors`, or a plugin's.

    Args: model: which. obs_len: observed steps. pred_len: steps to forecast. period:
        seconds between steps. changes: of the published sizes, each NAME=VALUE of a
        field of the configuration, such as
            `pooling=social` or `weighting=cnd`.

    Raises: InputError: for an unknown model, a change that does not fit, or one that
        makes it another
            model.
    """
    configs = known_configs()
    refuse(Literal[*configs], {"model": model})
    lengths = {"obs_len": obs_len, "pred_len": pred_len, "period": period}
    config = changed(
        dataclasses.replace(configs[model], **lengths), changes, "config", model
    )
    if (other := forecaster_of(config).model) != model:
        raise InputError(f"model {model!r}: {', '.join(changes)} makes it {other!r}")
    return config


def recipes_of(family: type[Forecaster]) -> dict[str, Recipe]:
    """A family's recipes by name, the usual one first."""
    return {**family.recipes} or {FORECASTERS.name_of(family): Recipe()}


def known_recipes() -> dict[str, Recipe]:
    """The recipes of all families that learn, by name."""
    return {
        name: recipe
        for family in _learners()
        for name, recipe in recipes_of(family).items()
    }


def known_configs() -> dict[str, Any]:
    """The configurations of all models that learn, by name."""
    configs: dict[str, Any] = {}
    for family in _learners():
        configs |= family.configs or {FORECASTERS.name_of(family): family.Config()}
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
