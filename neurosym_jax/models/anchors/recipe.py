"""The recipe of anchors and anchor tables; studies/pages/recipe.md has the reasons."""

import dataclasses

from neurosym_jax.configuration import (
    AtLeastOne,
    BelowOne,
    Count,
    NotNegative,
    Positive,
    Share,
    Whole,
)
from neurosym_jax.training.recipe import Recipe

__all__ = ["AnchorRecipe"]


@dataclasses.dataclass(frozen=True)
class AnchorRecipe(Recipe):
    """A recipe of anchors and anchor tables; a batch has scenes of one size class."""

    steps: Whole = 2500
    batch_scenes: Count = 128
    min_agents: Count = 1
    learning_rate: Positive = 4e-3
    ema: BelowOne = 0.99
    stretch: AtLeastOne = 1.6
    jitter: NotNegative = 0.04
    clean_share: BelowOne = 0.5
    single_agent_share: Share = 0.2
    batch_people: Count = 640
    """Largest number of people in a batch, padding included."""
    crowd_share: Share = 0.7
    """Probability that the scenes of a batch are merged into crowds, see `training.anchors`."""
    crowd_people: Count = 40
    """People in the largest crowds; their size is drawn log-uniformly."""
    joint_weight: NotNegative = 1.0
    """Weight in the loss of the best sample of each crowd."""
    marginal_weight: NotNegative = 0.75
    """Weight of the best sample of each person."""
    mean_weight: NotNegative = 0.01
    """Weight of the mean ADE over samples, by which every sample learns."""
    likely_weight: NotNegative = 0.05
    """Weight of the most probable sample of each crowd."""
    probability_weight: NotNegative = 0.05
    """Weight of the cross-entropy between the probabilities and a softmax of the joint errors."""
    temperature: Positive = 0.1
    """Temperature of that softmax, metres of error for a person."""
    energy_weight: NotNegative = 1.0
    """Weight of the energy score of each person's points."""
    step_weight: NotNegative = 0.5
    """Weight of the energy score of each person's position at single steps."""
    collision_weight: NotNegative = 0.0
    """Weight of how much people of one sample overlap. It costs error: see studies/pages/recipe.md."""
