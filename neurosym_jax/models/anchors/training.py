"""The training of anchors and anchor tables, by batches in which scenes are merged into crowds.

The best of k joint forecasts of two people may be bold; that of forty must be near the
mean. Small recordings have few crowds, so several scenes of a batch are scored as one:
their people do not see each other, but are counted, and one sample must fit all of
them. The points of a person are scored for that person alone, by a proper score.
"""

import dataclasses
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from neurosym_jax.configuration import (
    AtLeastOne,
    BelowOne,
    Count,
    NotNegative,
    Positive,
    Share,
    Whole,
)
from neurosym_jax.data.windows import Windows
from neurosym_jax.models.anchors.config import AnchorForecast, computed_once
from neurosym_jax.models.histories import shorten
from neurosym_jax.runtime.programs import full_precision
from neurosym_jax.scene import Scene
from neurosym_jax.training.batches import augment, gather_cropped
from neurosym_jax.training.recipe import Recipe

__all__ = [
    "CLASSES",
    "AnchorRecipe",
    "AnchorStream",
    "anchor_loss",
    "batch_loss",
    "company",
    "overlap",
    "personal_energy",
    "points_loss",
    "step_energy",
]


@dataclasses.dataclass(frozen=True)
class AnchorRecipe(Recipe):
    """A recipe of anchors and anchor tables; a batch has scenes of one size class.

    studies/pages/recipe.md has the reasons.
    """

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
    """Probability that the scenes of a batch are merged into crowds."""
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


CLASSES = (3, 9, 24)
"""Padded sizes of scenes; larger ones are cropped to a random agent and its nearest neighbours."""

PERSONAL = 0.4
"""Distance of two forecast people below which `collision_weight` counts them, metres."""


class AnchorStream:
    """Batches of `windows` of one size class each, by the recipe's seed and the step only."""

    def __init__(self, windows: Windows, recipe: AnchorRecipe):
        self._windows = windows
        self._recipe = recipe
        sizes = np.minimum(windows.sizes, CLASSES[-1])
        class_of = np.searchsorted(CLASSES, sizes)
        self._classes = list[tuple[int, np.ndarray]]()
        people = []
        for number, slots in enumerate(CLASSES):
            scenes = np.flatnonzero(class_of == number)
            if len(scenes):
                self._classes.append((slots, scenes))
                people.append(len(scenes) * sizes[scenes].mean())
        # A class is drawn as often as it has people.
        self._shares = np.array(people) / sum(people)

    def batch(self, step: int) -> tuple[Scene, np.ndarray]:
        """Scenes `[B, slots, ...]`, and the index [B] of the crowd that each is merged into."""
        recipe = self._recipe
        rng = np.random.default_rng([recipe.seed, step])
        number = rng.choice(len(self._classes), p=self._shares)
        slots, members = self._classes[number]
        count = max(1, min(recipe.batch_scenes, recipe.batch_people // slots))
        chosen = rng.choice(members, count)
        focus = np.zeros(count)
        sizes = self._windows.sizes[chosen]
        if sizes.max() > slots:
            focus = rng.random(count)
        merged = 1
        if rng.random() < recipe.crowd_share:
            scene_people = np.minimum(sizes, slots).mean()
            most = np.log(max(1, recipe.crowd_people / scene_people))
            merged = round(np.exp(rng.uniform(0, most)))
        scenes = gather_cropped(self._windows, chosen, slots, focus)
        return scenes, np.arange(count) // merged


def company(valid: Array, crowd: Array) -> Array:
    """[B] people of `valid` [B, N] in the other scenes of each scene's `crowd` [B], below B."""
    own = valid.sum(1)
    people = jax.ops.segment_sum(own, crowd, len(valid))
    others = people[crowd] - own
    return others.astype(jnp.float32)


def anchor_loss(
    forecast: AnchorForecast,
    future: Array,
    valid: Array,
    crowd: Array,
    recipe: AnchorRecipe,
) -> Array:
    """[] loss of a batch, per person.

    Args:
        forecast: of the scenes; its arrays have a leading axis B.
        future: [B, N, T, 2] metres.
        valid: [B, N] bool.
        crowd: [B] index of each scene's crowd, below B.
        recipe: weights of the terms.
    """

    def crowd_sum(values: Array) -> Array:
        return jax.ops.segment_sum(values, crowd, len(valid))

    samples, log_probability, points = forecast
    sizes = valid.sum(1, dtype=samples.dtype)
    people = crowd_sum(sizes)
    n = jnp.maximum(people, 1)

    planes = (
        samples.transpose(0, 4, 3, 1, 2) - future.transpose(0, 3, 2, 1)[..., None, :]
    )
    square = jnp.square(planes).sum(1)
    # Smooth at 0, where a sample meets the truth.
    distance = jnp.sqrt(square + 1e-9)
    distance = jnp.where(valid[:, None, None], distance, 0)
    ade = distance.mean(1)
    error = ade + recipe.fde_weight * distance[:, -1]  # [B, k, N]
    joint = crowd_sum(error.sum(2))  # [crowds, k]

    total = recipe.joint_weight * joint.min(1).sum()
    total += recipe.marginal_weight * error.min(1).sum()
    total += recipe.mean_weight * ade.mean(1).sum()

    log_probability = crowd_sum(log_probability * sizes[:, None]) / n[:, None]
    mean_error = joint / n[:, None]
    target = jax.nn.softmax(-mean_error / recipe.temperature)
    target = jax.lax.stop_gradient(target)
    agreement = (target * log_probability).sum(1)
    total -= recipe.probability_weight * (agreement * people).sum()
    likely = log_probability.argmax(1)[:, None]
    likely_error = jnp.take_along_axis(joint, likely, 1)
    total += recipe.likely_weight * likely_error.sum()

    if recipe.collision_weight:
        near = overlap(samples, valid).mean(1)
        total += recipe.collision_weight * near.sum()
    if points.shape[1]:
        total += points_loss(points, future, valid, recipe)
    return total / sizes.sum()


def points_loss(
    points: Array, future: Array, valid: Array, recipe: AnchorRecipe
) -> Array:
    """[] sum over people of the proper scores of their `points [B, P, N, T, 2]`, metres.

    `future` is [B, N, T, 2] metres, `valid` [B, N].
    """
    joint = jax.vmap(personal_energy)(points, future)
    single = jax.vmap(step_energy)(points, future)
    energy = recipe.energy_weight * joint + recipe.step_weight * single
    return jnp.where(valid, energy, 0).sum()


@full_precision
def personal_energy(points: Array, future: Array) -> Array:
    """[N] energy score of each person's equally probable `points [P, N, T, 2]`, metres.

    That of `evaluation.metrics.energy_score` given these probabilities, for points are
    no draws, of a scene of one person. `future` is [N, T, 2].
    """
    steps = points.shape[2]
    offset = (points - future[None]).swapaxes(0, 1)
    offset = offset.reshape(len(future), len(points), -1)
    product = jnp.einsum("npd,nqd->npq", offset, offset)
    square = jnp.diagonal(product, axis1=1, axis2=2)
    square_gap = square[:, :, None] + square[:, None] - 2 * product
    # Smooth at 0: points may meet each other and the truth.
    error = jnp.sqrt(square + 1e-6)
    spread = jnp.sqrt(jnp.maximum(square_gap, 0) + 1e-6)
    energy = error.mean(1) - spread.mean((1, 2)) / 2
    return energy / jnp.sqrt(steps)


def step_energy(points: Array, future: Array) -> Array:
    """[N] energy score of each person's position at one step, mean over every third step, metres.

    That of a whole trajectory hardly depends on how its steps are spread by themselves.
    """
    offset = points[:, :, ::-3] - future[:, ::-3]
    offset = jnp.moveaxis(offset, 0, -1)  # [N, steps, 2, P]
    gap = offset[..., None] - offset[..., None, :]
    error = jnp.sqrt(jnp.square(offset).sum(2) + 1e-6)
    spread = jnp.sqrt(jnp.square(gap).sum(2) + 1e-6)
    energy = error.mean(-1) - spread.mean((-1, -2)) / 2
    return energy.mean(1)


def overlap(forecast: Array, valid: Array) -> Array:
    """[B, k, N] how far within `PERSONAL` metres others of the scene are, 0 to 1, summed over them
    and the mean over time; `forecast [B, k, N, T, 2]` metres, `valid [B, N]`."""
    offset = forecast[:, :, :, None] - forecast[:, :, None]
    square_distance = jnp.square(offset).sum(-1)
    itself = jnp.eye(valid.shape[1], dtype=bool)
    others = valid[:, :, None] & valid[:, None] & ~itself[None]
    near = jnp.maximum(1 - square_distance / PERSONAL**2, 0)
    near = jnp.where(others[:, None, ..., None], near, 0)
    return near.mean(-1).sum(-1)


def batch_loss(
    apply: Callable[..., AnchorForecast],
    batch: tuple[Scene, Array],
    key: Array,
    recipe: AnchorRecipe,
    short: bool = False,
) -> tuple[Array, dict[str, Array]]:
    """[] loss of a batch of `AnchorStream`, augmented; consumes `key`.

    `apply` gives the forecast of one scene, given the number of people in
    company, see `AnchorNetwork`. If `short`, histories are cut, see `shorten`.
    """
    scenes, crowd = batch
    cut = None
    if short:
        key, cut = jax.random.split(key)
    (scenes,) = augment((scenes,), key, recipe)
    scenes: Any = jax.tree.map(jnp.asarray, scenes)
    if cut is not None:
        # At last: nobody's tracking errs where nobody was seen.
        scenes = shorten(scenes, cut)
    scenes = computed_once(scenes)
    bare = scenes.replace(future=None)
    forecast = jax.vmap(apply)(bare, company(scenes.valid, crowd))
    return anchor_loss(forecast, scenes.known_future, scenes.valid, crowd, recipe), {}
