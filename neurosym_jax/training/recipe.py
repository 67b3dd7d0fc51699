"""What every recipe of training has; families add their own fields."""

import dataclasses
from collections.abc import Callable, Mapping
from typing import Any, Literal

from neurosym_jax.configuration import (
    AtLeastOne,
    BelowOne,
    Checked,
    Count,
    NotNegative,
    Positive,
    Seed,
    Share,
    Whole,
)

__all__ = ["Recipe"]


@dataclasses.dataclass(frozen=True)
class Recipe(Checked):
    """What all recipes have."""

    seed: Seed = 0
    steps: Whole = 3000
    """Steps of training; of a generator where there is a discriminator."""
    batch_scenes: Count = 64
    """Scenes in a batch: approximately, with fixed proportions of sizes; of anchors at most."""
    min_agents: Count = 2
    """Training scenes with fewer people are left out."""
    learning_rate: Positive = 1e-2
    """Learning rate of Adam; of the generator where there is a discriminator."""
    schedule: Literal["constant", "cosine"] = "cosine"
    warmup_steps: Whole = 100
    """Steps in which the learning rate of the cosine schedule rises; at most half of all."""
    clip_norm: NotNegative = 2.0
    """Largest norm of the gradient, of a generator's; 0 for no clipping."""
    clip_epsilon: NotNegative = 0.0
    """Added to the norm that a larger gradient is divided by: 1e-6 in torch."""
    ema: BelowOne = 0.0
    """Decay of the averaged parameters, which are validated and kept; 0 averages none."""
    validate_every: Count = 500
    """Steps between validations; the best state by validation is kept."""
    patience: Whole = 0
    """Validations in a row without a better one, after which training ends; 0 for never."""
    freeze: tuple[str, ...] = ()
    """Modules of the network that do not learn, by name, such as encoder."""
    select_by: Literal["ade", "ade_fde", "energy"] | None = None
    """Validation error that chooses the best state: joint ADE, its sum with joint FDE, or the
    energy score; default: energy of networks with a distribution of their own, else ade_fde."""
    fde_weight: NotNegative = 0.5
    """Weight of the FDE beside the ADE in the loss."""

    rotate: Share = 1.0
    """Probability that a training scene is rotated by a random angle, and then mirrored with
    probability 1/2."""
    scale: BelowOne = 0.0
    """Each training scene is scaled by a random factor within 1 ± scale."""
    stretch: AtLeastOne = 1.0
    """In place of `scale`: the factor is log-uniform from 1 / stretch to stretch."""
    jitter: NotNegative = 0.0
    """Largest standard deviation of noise added to a scene's observed positions, m."""
    clean_share: BelowOne = 0.0
    """Probability that a training scene gets no such noise. Recordings differ in their noise."""
    single_agent_share: Share = 0.0
    """Probability that a training scene is reduced to one random person."""

    def optimizer(self) -> Any:
        """The optax optimiser that follows the clipping; None is Adam by `learning_rate`."""
        return None

    def scheduled(self) -> Mapping[str, Callable[[Any], Any]]:
        """Parameters that do not learn: a function of the step, by dotted path."""
        return {}
