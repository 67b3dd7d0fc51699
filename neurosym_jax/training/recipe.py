"""What is trained and how: networks by name, and recipes, the hyper-parameters of training."""

import dataclasses
from collections.abc import Sequence
from typing import Any, Literal

from neurosym_jax.configuration import (
    AtLeastOne,
    BelowOne,
    Checked,
    Count,
    Interval,
    NotNegative,
    Positive,
    Seed,
    Share,
    Whole,
    changed,
    differences,
    refuse,
)
from neurosym_jax.errors import InputError
from neurosym_jax.models.anchors import AnchorConfig, AnchorTableConfig
from neurosym_jax.models.config import POOLINGS, DiscriminatorConfig, GeneratorConfig

__all__ = ["NETWORKS", "RECIPES", "AnchorRecipe", "Recipe", "TrainConfig", "make_recipe"]
__all__ += ["model_name", "named_network", "refuse_other_recipe", "usual_recipe"]


@dataclasses.dataclass(frozen=True)
class Recipe(Checked):
    """What all recipes have."""

    seed: Seed = 0
    steps: Count = 3000
    """Steps of training; of a generator where there is a discriminator."""
    batch_scenes: Count = 64
    """Scenes in a batch: approximately, with fixed proportions of sizes; of anchors at most."""
    min_agents: Count = 2
    """Training scenes with fewer people are left out."""
    learning_rate: Positive = 1e-2
    """Learning rate of Adam; of the generator where there is a discriminator."""
    schedule: Literal["constant", "cosine"] = "cosine"
    warmup_steps: Whole = 100
    clip_norm: NotNegative = 2.0
    """Largest norm of the gradient, of a generator's; 0 for no clipping."""
    ema: BelowOne = 0.0
    """Decay of the averaged parameters, which are validated and kept; 0 averages none."""
    validate_every: Count = 500
    """Steps between validations; the best state by validation is kept."""
    select_by: Literal["ade", "ade_fde"] = "ade_fde"
    """Joint validation error that chooses the best state."""
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


@dataclasses.dataclass(frozen=True)
class TrainConfig(Recipe):
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
    `training.step`."""
    discriminator: DiscriminatorConfig = DiscriminatorConfig()  # noqa: RUF009 (frozen)


@dataclasses.dataclass(frozen=True)
class AnchorRecipe(Recipe):
    """A recipe of anchors and anchor tables; a batch has scenes of one size class."""

    steps: Count = 2500
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
    collision_weight: NotNegative = 0.0
    """Weight of how much people of one sample overlap. It costs error: see docs/recipe.md."""


RECIPES: dict[str, Recipe] = {
    "anchors": AnchorRecipe(),
    "ours": TrainConfig(rotate=0.5, scale=0.3, jitter=0.04, gentle_pooling=True),
    "sgan": TrainConfig(
        max_agents=None,
        steps=8400,
        criterion="squared_displacement",
        adversarial_weight=1.0,
        # The released code smooths zeros by multiplying them by the random number: they stay 0.
        label_fake=(0.0, 0.0),
        learning_rate=1e-4,
        schedule="constant",
        warmup_steps=0,
        rotate=0.0,
        select_by="ade",
    ),
}
"""`sgan` is the published procedure; `ours` and `anchors` are justified in docs/recipe.md."""


def make_recipe(
    name: str, *, seed: int = 0, steps: int | None = None, changes: Sequence[str] = ()
) -> Recipe:
    """The recipe of this name; `changes` are NAME=VALUE, a value as JSON or as text.

    Raises:
        InputError: for an unknown name, a change that is not NAME=VALUE of a field, or a value out
            of its range.
    """
    refuse(Literal[*RECIPES], {"recipe": name})
    of_steps = [] if steps is None else [f"steps={steps}"]
    every = [f"seed={seed}", *of_steps, *changes]
    return changed(RECIPES[name], every, "--set", f"recipe {name}")


def usual_recipe(network: Any) -> str:
    """The name of the recipe by which a network is trained unless another is asked for."""
    return "ours" if isinstance(network, GeneratorConfig) else "anchors"


def refuse_other_recipe(network: Any, recipe: Any) -> None:
    """Refuse a recipe of another kind of network.

    Raises:
        InputError: naming the recipes that fit.
    """
    kind = type(RECIPES[usual_recipe(network)])
    if not isinstance(recipe, kind):
        fits = ", ".join(name for name, of in RECIPES.items() if isinstance(of, kind))
        raise InputError(f"the recipe does not fit the network: --recipe {fits}")


NETWORKS: dict[str, Any] = {
    "sgan": GeneratorConfig(),
    "neurosym": GeneratorConfig(pooling=POOLINGS["as_described"]()),
    "anchors": AnchorConfig(),
    "anchor_table": AnchorTableConfig(),
}
"""Configurations, with the poolings of the papers."""


def named_network(
    model: str = "sgan",
    *,
    pooling: str | None = None,
    weighting: str | None = None,
    obs_len: int = 8,
    pred_len: int = 8,
    changes: Sequence[str] = (),
) -> Any:
    """The configuration of `sgan`, `neurosym`, `anchors` or `anchor_table`.

    Args:
        model: which.
        pooling: of a generator; default: the paper's. That of NeuroSyM takes weights.
        weighting: of NeuroSyM (default: `cnd`) or anchors (default: none), as
            KIND[,FIELD=VALUE...].
        obs_len: observed steps.
        pred_len: steps to forecast.
        changes: of the published sizes, each NAME=VALUE of a field of the configuration.

    Raises:
        InputError: for an unknown model, pooling or weighting, one that the model cannot have, or a
            change that does not fit.
    """
    refuse(Literal[*NETWORKS], {"model": model})
    config = dataclasses.replace(NETWORKS[model], obs_len=obs_len, pred_len=pred_len)
    if pooling is not None:
        takes = {"sgan": set(), "neurosym": {"alpha"}}.get(model)  # Of pairs' weights.
        known = [n for n, of in POOLINGS.items() if of.inputs & {"alpha", "alpha_rows"} == takes]
        if POOLINGS[pooling] and pooling not in known:
            raise InputError(f"--pooling {pooling}: {model} has {', '.join(known) or 'no pooling'}")
    if weighting is not None and model == "sgan":
        raise InputError(f"--weighting {weighting}: {model} weights no pairs; neurosym does")
    asked = {"pooling": pooling, "weighting": weighting}
    own = [f"{name}={value}" for name, value in asked.items() if value is not None]
    return changed(config, [*own, *changes], "--network", "network")


def model_name(config: Any) -> str:
    """A name that tells apart models trained on the same data."""
    if isinstance(config, GeneratorConfig):
        pooling = POOLINGS.name_of(config.pooling)
        if config.weighting is None:
            return f"sgan_{pooling}"
        return f"neurosym_{pooling.removeprefix('neurosym_')}_{config.weighting.name}"
    lengths = ("obs_len=", "pred_len=", "period=")
    own = [each for each in differences(config) if not each.startswith(lengths)]
    name = "anchors" if isinstance(config, AnchorConfig) else "anchor_table"
    return "_".join([name, *(each.replace("=", "_") for each in own)])
