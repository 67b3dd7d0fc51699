"""Recipes of SGAN and NeuroSyM: `ours` (docs/recipe.md), and `sgan`, the published procedure."""

import dataclasses
from typing import Literal

from neurosym_jax.configuration import Count, Interval, NotNegative, Positive
from neurosym_jax.models.sgan.config import DiscriminatorConfig
from neurosym_jax.training.recipe import Recipe

__all__ = ["RECIPES", "GeneratorRecipe"]


@dataclasses.dataclass(frozen=True)
class GeneratorRecipe(Recipe):
    """A recipe of SGAN and NeuroSyM."""

    max_agents: Count | None = 16
    """Larger scenes are cropped to a random agent and its nearest neighbours, drawn each time."""
    best_k: Count = 20
    """Samples of the variety loss, which learns from the best one."""
    variety_weight: NotNegative = 1.0
    """Weight of the variety loss; 0 leaves the adversarial loss only."""
    criterion: Literal["squared_displacement", "distance"] = "distance"
    """The variety loss and what is best by it: SGAN's squared displacements, a sum over scenes; or
    ADE and FDE, each with its own best, a mean over people as in the test."""
    adversarial_weight: NotNegative = 0.0
    """Weight of the adversarial loss; 0 trains no discriminator."""
    label_real: Interval = (0.7, 1.2)
    """Range of the smoothed label of real trajectories, drawn once a step."""
    label_fake: Interval = (0.0, 0.3)
    """Range of the label of forecasts, drawn once a step."""
    d_learning_rate: Positive = 1e-3
    """Learning rate of the discriminator."""
    discriminator_steps: Count = 1
    """Steps of the discriminator before each step of the generator, each on a batch of its own."""
    gentle_pooling: bool = False
    """Train the pooling slowly, from a small start, so that its units do not die: see
    `models.sgan.step`."""
    discriminator: DiscriminatorConfig = DiscriminatorConfig()  # noqa: RUF009 (frozen)


RECIPES = {
    "ours": GeneratorRecipe(rotate=0.5, scale=0.3, jitter=0.04, gentle_pooling=True),
    "sgan": GeneratorRecipe(
        max_agents=None,
        steps=8400,
        criterion="squared_displacement",
        adversarial_weight=1.0,
        # The released code smooths zeros by multiplying them by the random number: they
        # stay 0.
        label_fake=(0.0, 0.0),
        learning_rate=1e-4,
        schedule="constant",
        warmup_steps=0,
        rotate=0.0,
        select_by="ade",
    ),
}
