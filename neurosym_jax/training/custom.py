"""What a caller of `train` puts in place of the recipe's: a loss, an optimiser, schedules.

Each becomes the method of a subclass, as a plugin would write it: a loss overrides
`Forecaster.loss`, an optimiser `Recipe.optimizer`, schedules `Recipe.scheduled`.
"""

import dataclasses
import functools
import inspect
from collections.abc import Callable, Mapping
from typing import Any

import jax
import jax.numpy as jnp
from jax import Array

from neurosym_jax.errors import InputError
from neurosym_jax.models.forecaster import FORECASTERS, Forecaster
from neurosym_jax.scene import Scene
from neurosym_jax.training.recipe import Recipe
from neurosym_jax.training.state import batch_samples, call_own

__all__ = ["Custom", "SceneLoss", "make_custom"]

SceneLoss = Callable[[Array, Scene], Array]
"""`(forecast [k, N, pred_len, 2] metres, scene) -> [] loss` of one scene, whose `known_future`
[N, pred_len, 2] is the truth and `valid` [N] marks people."""
UNNAMED = "<own>"
"""In the name of a class, says that programs with it are not kept between processes."""
Schedules = tuple[tuple[str, Callable[[Any], Any]], ...]


@dataclasses.dataclass(frozen=True)
class Custom:
    """A loss, an optimiser and schedules of one's own; None and () are the recipe's."""

    loss: SceneLoss | None = None
    optimizer: Any = None
    """An optax optimiser, which follows the recipe's clipping."""
    schedule: Schedules = ()
    """Dotted paths of parameters that do not learn, and their values by step."""

    def forecaster(self, forecaster: Forecaster) -> Forecaster:
        """The forecaster with the loss."""
        if self.loss is None:
            return forecaster
        return _family_with(type(forecaster), self.loss)(forecaster.config)

    def refuse_unheard(self, forecaster: Forecaster) -> None:
        """Refuse a family whose rounds did not call the loss when they were first run.

        Raises:
            InputError: naming the family.
        """
        if self.loss is not None and not getattr(forecaster, "heard", True):
            raise InputError(
                f"loss: {forecaster.title} trains by rounds of its own, which do not "
                "call Forecaster.loss, so it cannot take a loss of your own"
            )

    def recipe(self, recipe: Recipe) -> Recipe:
        """The recipe with the optimiser and the schedules."""
        if self.optimizer is None and not self.schedule:
            return recipe
        cls = _recipe_with(type(recipe), self.optimizer, self.schedule)
        entries = dataclasses.fields(recipe)
        return cls(**{entry.name: getattr(recipe, entry.name) for entry in entries})

    def facts(self) -> dict[str, str]:
        """Names of the functions, for the record and the card."""
        facts = {}
        if self.loss is not None:
            facts["own loss"] = _name_of(self.loss)
        if self.optimizer is not None:
            facts["own optimizer"] = _name_of(self.optimizer.init)
        if self.schedule:
            names = [f"{path} by {_name_of(value)}" for path, value in self.schedule]
            facts["own schedule"] = ", ".join(names)
        return facts


def make_custom(
    loss: SceneLoss | None,
    optimizer: Any,
    schedule: Mapping[str, Callable[[Any], Any]] | None,
) -> Custom:
    """The arguments of `train`, checked.

    Raises:
        InputError: naming the argument that is no function or optimiser.
    """
    if loss is not None and not _takes(loss, "forecast", "scene"):
        raise InputError("loss: must be a function (forecast, scene) -> [] loss")
    if optimizer is not None and not _is_optimizer(optimizer):
        raise InputError("optimizer: must be one of optax, such as optax.adamw(1e-3)")
    if not isinstance(schedule, Mapping | None):
        raise InputError(
            "schedule: must be a dictionary of functions of the step by dotted path"
        )
    schedules = dict(schedule or {})
    for path, value in schedules.items():
        if not _takes(value, "step"):
            raise InputError(f"schedule of {path}: must be a function of the step")
    return Custom(loss, optimizer, tuple(schedules.items()))


def _takes(function: Any, *names: str) -> bool:
    """Whether a function can be called with so many arguments, as far as can be told."""
    try:
        signature = inspect.signature(function)
    except TypeError:
        return False
    except ValueError:  # Of some that are written in C.
        return True
    try:
        signature.bind(*names)
    except TypeError:
        return False
    return True


def _is_optimizer(optimizer: Any) -> bool:
    methods = [getattr(optimizer, name, None) for name in ("init", "update")]
    return not isinstance(optimizer, type) and all(map(callable, methods))


def scene_losses(
    loss: SceneLoss,
    forecaster: Forecaster,
    params: Any,
    batch: Any,
    key: Array,
    recipe: Any,
) -> tuple[Array, dict[str, Array]]:
    """[] mean of `loss` over the scenes of a batch, augmented; consumes `key`.

    Raises:
        InputError: for a loss that returns no single number.
    """
    total = jnp.zeros(())
    scenes_with_people = jnp.zeros(())
    groups = forecaster.groups_of(batch)
    for scenes, futures in batch_samples(forecaster, params, groups, key, recipe):
        mapped = jax.vmap(loss, in_axes=(1, 0))
        values = call_own("loss", mapped, futures, scenes)
        occupied = scenes.valid.any(axis=1)
        _refuse_other_values(values, occupied.shape)
        # Selected before the sum and its gradient: an empty scene may give NaN.
        total += jnp.where(occupied, values, 0).sum()
        scenes_with_people += occupied.sum(dtype=total.dtype)
    return total / scenes_with_people, {}


def _refuse_other_values(values: Any, shape: tuple[int, ...]) -> None:
    """Refuse a loss that did not return one real number for each of `shape` scenes."""
    message = "loss: must return one number for a scene, not"
    if not isinstance(values, Array):
        raise InputError(f"{message} {type(values).__name__}")
    if values.shape != shape:
        raise InputError(f"{message} {list(values.shape[1:])}")
    if not jnp.issubdtype(values.dtype, jnp.floating):
        raise InputError(f"{message} {values.dtype}, which has no gradient")


# Cached, because equal classes share compiled programs.


@functools.lru_cache(maxsize=64)
def _family_with(family: type[Forecaster], own: SceneLoss) -> type[Forecaster]:
    def loss(
        self: Any, params: Any, batch: Any, key: Array, recipe: Any
    ) -> tuple[Array, Any]:
        type(self).heard = True
        return scene_losses(own, self, params, batch, key, recipe)

    parts = {
        "loss": loss,
        "heard": False,
        "key": property(lambda self: FORECASTERS.name_of(family)),
        "__qualname__": f"{family.__qualname__}.{UNNAMED}",
    }
    return type(family.__name__, (family,), parts)


@functools.lru_cache(maxsize=64)
def _recipe_with(
    recipe: type[Recipe], optimizer: Any, schedule: Schedules
) -> type[Recipe]:
    parts: dict[str, Any] = {"__qualname__": f"{recipe.__qualname__}.{UNNAMED}"}
    if optimizer is not None:
        parts["optimizer"] = lambda self: optimizer
    if schedule:
        parts["scheduled"] = lambda self: dict(schedule)
    return type(recipe.__name__, (recipe,), parts)


def _name_of(function: Any) -> str:
    """`adamw` of a function made in `adamw`; the name of any other."""
    name = getattr(function, "__qualname__", type(function).__qualname__)
    return name.split(".<locals>")[0]
