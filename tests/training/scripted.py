"""A family that follows a script: what a training does with errors and losses is seen at once.

It learns nothing. Its forecasts of people who stand err by the metres that the script
has for the step, so real validations find real errors, in milliseconds.
"""

import dataclasses
from typing import ClassVar

import jax.numpy as jnp
import numpy as np

from neurosym_jax.models.forecaster import Forecaster, Lengths, register_forecaster
from neurosym_jax.training.recipe import Recipe

LONGEST = 100
"""Most steps of a script."""


@dataclasses.dataclass(frozen=True)
class ScriptedConfig(Lengths):
    """Lengths alone; the type tells the family."""


@dataclasses.dataclass(frozen=True)
class Scripted(Forecaster):
    """Everybody stands, `errors[step]` metres from where they are."""

    Config: ClassVar[type] = ScriptedConfig
    errors: ClassVar[dict[int, float]] = {}
    """Metres that forecasts err by after so many steps; 1 where nothing is said."""
    stable_rate: ClassVar[float] = np.inf
    """Learning rate beyond which losses are not finite."""
    stable_steps: ClassVar[int] = 0
    """Steps in which they are, whatever the rate."""

    @property
    def sees_neighbours(self):
        return False

    def init(self, key):
        metres = np.ones(LONGEST + 1, np.float32)
        for step, error in self.errors.items():
            metres[step] = error
        return {"step": jnp.zeros(()), "errors": jnp.asarray(metres)}

    def forecast(self, params, scene, noise):
        error = params["errors"][params["step"].astype(int)]
        last = scene.observed[:, -1:] + jnp.stack([error, jnp.zeros(())])
        return jnp.repeat(last, self.pred_len, axis=1)[None]

    def rounds(self, windows, recipe, key):
        def advance(state, done, count):
            steps = np.arange(done, done + count)
            unstable = recipe.learning_rate > self.stable_rate
            bad = unstable & (steps >= self.stable_steps)
            params = {**state.params, "step": jnp.asarray(float(done + count))}
            average = params if recipe.ema else ()
            state = state._replace(
                step=state.step + count, params=params, average=average
            )
            rate = np.full(count, recipe.learning_rate)
            return state, {"loss": np.where(bad, np.nan, 1.0), "rate": rate}

        return advance


@dataclasses.dataclass(frozen=True)
class DrawnConfig(Lengths):
    """That of the family whose draws are trained by a proper score."""


@dataclasses.dataclass(frozen=True)
class Drawn(Scripted):
    """Its forecasts are draws of a distribution."""

    Config: ClassVar[type] = DrawnConfig

    @property
    def calibrated(self):
        return True


RECIPE = Recipe(steps=4, validate_every=2, schedule="constant", learning_rate=0.004)


def standing(windows):
    """The same windows, in which nobody moves."""
    position = np.broadcast_to(windows.position[:, :1], windows.position.shape)
    return dataclasses.replace(windows, position=position.copy())


def write_script(errors=(), *, every=2, stable_rate=np.inf, stable_steps=0):
    """Let validations, one `every` so many steps, find these errors; and losses see above."""
    Scripted.errors = {every * (at + 1): error for at, error in enumerate(errors)}
    Scripted.stable_rate, Scripted.stable_steps = stable_rate, stable_steps


def register():
    register_forecaster("scripted", Scripted)
    register_forecaster("drawn", Drawn)
