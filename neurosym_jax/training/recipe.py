"""Recipes: the hyper-parameters of training."""

import abc
import dataclasses
from collections.abc import Sequence
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
    changed,
)
from neurosym_jax.models.config import DiscriminatorConfig
from neurosym_jax.training.anchor_loss import AnchorLossOptions
from neurosym_jax.training.augmentation import AugmentationOptions
from neurosym_jax.training.losses import LossOptions, refuse_no_loss

__all__ = ["RECIPES", "AnchorRecipe", "Recipe", "TrainConfig", "make_recipe"]


@dataclasses.dataclass(frozen=True)
class Recipe(AugmentationOptions, Checked, abc.ABC):
    """What all recipes have; the options of losses and augmentations stand in their files."""

    seed: Seed = 0
    steps: Count = 3000
    """Steps of training; of a generator where there is a discriminator."""
    min_agents: Count = 2
    """Training scenes with fewer people are left out."""
    warmup_steps: Whole = 100
    clip_norm: NotNegative = 2.0
    """Largest norm of the gradient, of a generator's; 0 for no clipping."""
    ema: BelowOne = 0.0
    """Decay of the averaged parameters, which are validated and kept; 0 averages none."""
    validate_every: Count = 500
    """Steps between validations; the best state by validation is kept."""
    select_by: Literal["ade", "ade_fde"] = "ade_fde"
    """Joint validation error that chooses the best state."""

    @abc.abstractmethod
    def samples(self, network: Any) -> int:
        """Number of samples of which validation takes the best."""


@dataclasses.dataclass(frozen=True)
class TrainConfig(LossOptions, Recipe):
    """A recipe of SGAN and NeuroSyM."""

    batch_scenes: Count = 64
    """Approximate number of scenes in a batch; the proportions of sizes are fixed."""
    max_agents: Count | None = 16
    """Larger scenes are cropped to a random agent and its nearest neighbours, drawn each time."""
    best_k: Count = 20
    """Samples of the variety loss, which learns from the best one."""
    g_learning_rate: Positive = 1e-2
    d_learning_rate: Positive = 1e-3
    schedule: Literal["constant", "cosine"] = "cosine"
    gentle_pooling: bool = False
    """Train the pooling slowly, from a small start, so that its units do not die: see
    `training.gentle_pooling`."""
    discriminator: DiscriminatorConfig = dataclasses.field(default_factory=DiscriminatorConfig)

    def __post_init__(self):
        """Refuse, before any step, what would fail late or train nothing."""
        super().__post_init__()
        refuse_no_loss(self)

    def samples(self, network: Any) -> int:
        """See `Recipe.samples`."""
        return self.best_k


@dataclasses.dataclass(frozen=True)
class AnchorRecipe(AnchorLossOptions, Recipe):
    """A recipe of anchors and anchor tables; a batch has scenes of one size class."""

    steps: Count = 2500
    min_agents: Count = 1
    rotate: bool | Share = 1.0
    stretch: AtLeastOne = 1.6
    jitter: NotNegative = 0.04
    clean_share: BelowOne = 0.5
    single_agent_share: Share = 0.2
    learning_rate: Positive = 4e-3
    ema: BelowOne = 0.99
    batch_people: Count = 640
    """People in a batch, padding included."""
    batch_scenes: Count = 128
    """Most scenes in a batch."""
    crowd_tilt: float = 1.0
    """A size class is drawn in proportion to its scenes times their mean size to this power."""
    crowd_share: Share = 0.7
    """Probability that the scenes of a batch are merged into crowds, see `anchor_loss`."""
    crowd_people: Count = 40
    """People in the largest crowds; their size is drawn log-uniformly."""

    def samples(self, network: Any) -> int:
        """See `Recipe.samples`."""
        return network.samples


RECIPES: dict[str, Recipe] = {
    "anchors": AnchorRecipe(),
    "ours": TrainConfig(rotate=0.5, scale=0.3, jitter=0.04, gentle_pooling=True),
    "sgan": TrainConfig(
        max_agents=None,
        steps=8400,
        criterion="squared_displacement",
        weigh_scenes="equally",
        adversarial_weight=1.0,
        # The released code smooths zeros by multiplying them by the random number: they stay 0.
        label_fake=(0.0, 0.0),
        g_learning_rate=1e-4,
        schedule="constant",
        warmup_steps=0,
        rotate=0.0,
        select_by="ade",
    ),
}
"""`sgan` is the published procedure; `ours` and `anchors` are justified in docs/training.md."""


def make_recipe(
    name: str, *, seed: int = 0, steps: int | None = None, changes: Sequence[str] = ()
) -> Recipe:
    """The recipe of this name, with changes to it.

    Args:
        name: a key of `RECIPES`.
        seed: of everything random.
        steps: of training; None for the recipe's.
        changes: each NAME=VALUE of a field, its value as JSON or as text.

    Raises:
        InputError: for a change that is not NAME=VALUE of a field, or a value out of its range.
    """
    if steps is not None:
        changes = [f"steps={steps}", *changes]
    return changed(RECIPES[name], [f"seed={seed}", *changes], "--set", f"recipe {name}")
