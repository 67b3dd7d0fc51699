"""The losses of training: criteria that choose the best of k forecasts, and terms of the loss.

To add one: its function, an entry in `CRITERIA` or `TERMS`, and its options in `LossOptions`, which
are fields of every recipe.
"""

import dataclasses
import functools
import operator
from collections.abc import Callable, Sequence
from typing import Literal, NamedTuple

import jax
import jax.numpy as jnp
from jax import Array

from neurosym_jax.configuration import Interval, NotNegative
from neurosym_jax.errors import InputError
from neurosym_jax.scene import AnyArray, Scene
from neurosym_jax.training.groups import Groups

__all__ = [
    "CRITERIA",
    "TERMS",
    "Criterion",
    "Forecasts",
    "LossOptions",
    "Term",
    "adversarial_loss",
    "criterion_errors",
    "displacements",
    "distance_errors",
    "generator_loss",
    "refuse_no_loss",
    "safe_norm",
    "squared_displacement_errors",
]


@dataclasses.dataclass(frozen=True)
class LossOptions:
    """The options of a recipe's losses."""

    criterion: Literal["squared_displacement", "distance"] = "distance"
    """How the best forecast is chosen: SGAN's squared displacements, or ADE and FDE, each with its
    own best."""
    fde_weight: NotNegative = 0.5
    """Weight of the FDE in the criterion `distance`."""
    weigh_scenes: Literal["equally", "by_agents"] = "by_agents"
    """SGAN's loss weighs every scene the same; the test's average weighs every agent the same."""
    l2_weight: NotNegative = 1.0
    """Weight of the variety loss: the best of k forecasts by the criterion."""
    adversarial_weight: NotNegative = 0.0
    """Weight of the adversarial loss; 0 trains no discriminator."""
    label_real: Interval = (0.7, 1.2)
    """Range of the smoothed label of real trajectories, drawn once a step."""
    label_fake: Interval = (0.0, 0.3)
    """Range of the label of forecasts, drawn once a step."""


class Criterion(NamedTuple):
    """How the best of k forecasts of a scene is chosen, and what it adds to the variety loss."""

    errors: Callable[[Scene, Array], Array]
    """[C, k] of one scene and its forecasts [k, N, pred_len, 2] in metres; each of the C rows has a
    best forecast of its own."""
    weights: Callable[[LossOptions], Sequence[float]]
    """[C] of the rows in the loss."""
    mean: bool
    """Whether a batch's loss is the mean over its scenes (or agents), else their sum."""


class Forecasts(NamedTuple):
    """The generator's forecasts of a batch: the input of the terms of its loss."""

    groups: Groups
    futures: list[Array]
    """[C, scenes, slots, pred_len, 2] metres of each group, the best by row c of the criterion."""
    scores: Array | None
    """[A] logits of all slots; None without a discriminator."""
    label: Array | float
    """[] the discriminator's label that the forecasts should get."""


class Term(NamedTuple):
    """A term of the generator's loss; `metrics.jsonl` has it as `g_NAME`."""

    weight: str
    """Name of the option that is its weight; 0 leaves the term out."""
    value: Callable[[LossOptions, Forecasts], Array]


def squared_displacement_errors(forecast: AnyArray, truth: AnyArray, valid: AnyArray) -> Array:
    """SGAN's criterion of one scene: one value a sample, square metres.

    Args:
        forecast: [k, N, pred_len, 2] displacements in metres.
        truth: [N, pred_len, 2] displacements in metres.
        valid: [N] bool.

    Returns:
        [1, k]: squared error summed over agents, steps and coordinates, divided by the number of
        valid agents and steps.
    """
    squared = jnp.where(valid[:, None, None], (forecast - truth) ** 2, 0).sum(axis=(1, 2, 3))
    return (squared / (jnp.maximum(valid.sum(), 1) * truth.shape[1]))[None]


def distance_errors(forecast: AnyArray, truth: AnyArray, valid: AnyArray) -> Array:
    """[2, k] metres: ADE and FDE of each sample of one scene, means over its valid agents.

    Arguments are those of `squared_displacement_errors`, but positions in place of displacements.
    """
    distance = jnp.where(valid[:, None], safe_norm(forecast - truth), 0)
    agents = jnp.maximum(valid.sum(), 1)
    ade = distance.mean(axis=-1).sum(axis=-1) / agents
    return jnp.stack([ade, distance[..., -1].sum(axis=-1) / agents])


def _of_displacements(scene: Scene, futures: AnyArray) -> Array:
    last = scene.observed[:, -1:]
    return squared_displacement_errors(
        displacements(last, futures), displacements(last, scene.known_future), scene.valid
    )


def displacements(last: AnyArray, future: AnyArray) -> Array:
    """Displacements of `future [..., pred_len, 2]` that follows the position `last [..., 1, 2]`."""
    start = jnp.broadcast_to(last, (*future.shape[:-2], 1, 2))
    return jnp.diff(jnp.concatenate([start, future], axis=-2), axis=-2)


def safe_norm(vector: AnyArray) -> Array:
    """Euclidean norm over the last axis, with gradient zero where the vector is zero.

    NaN stays NaN; as zero it would be the best of all errors.
    """
    squared = (vector**2).sum(axis=-1)
    zero = squared == 0
    return jnp.where(zero, 0, jnp.sqrt(jnp.where(zero, 1, squared)))


CRITERIA = {
    # SGAN's loss is a sum over scenes; a mean keeps `distance` in metres, whatever the batch.
    "squared_displacement": Criterion(_of_displacements, lambda _: (1.0,), mean=False),
    "distance": Criterion(
        lambda scene, futures: distance_errors(futures, scene.known_future, scene.valid),
        lambda options: (1.0, options.fde_weight),
        mean=True,
    ),
}


def criterion_errors(options: LossOptions, scene: Scene, futures: Array) -> Array:
    """[scenes, C, k] of one group's `futures [k, scenes, slots, pred_len, 2]`."""
    return jax.vmap(CRITERIA[options.criterion].errors, in_axes=(0, 1))(scene, futures)


def variety_loss(options: LossOptions, made: Forecasts) -> Array:
    """[] the criterion of the best forecasts; future c is the best by row c."""
    criterion = CRITERIA[options.criterion]
    weights = criterion.weights(options)
    total = jnp.zeros(())
    by_agents = options.weigh_scenes == "by_agents"
    for scene, future in zip(made.groups, made.futures):
        best = jnp.diagonal(criterion_errors(options, scene, future), axis1=1, axis2=2)
        value = functools.reduce(operator.add, [w * best[:, c] for c, w in enumerate(weights)])
        agents = scene.valid.sum(axis=1).astype(value.dtype)
        share = agents if by_agents else (agents > 0).astype(value.dtype)
        total = total + (value * share).sum()
    if not criterion.mean:
        return total
    sizes = jnp.concatenate([scene.valid.sum(axis=1) for scene in made.groups])
    return total / (sizes.sum() if by_agents else (sizes > 0).sum())


def adversarial_loss(scores: Array, label: Array | float, valid: AnyArray) -> Array:
    """Binary cross-entropy of `scores [A]` (logits) with one smoothed label, mean over valid `[A]`.

    The stable form `max(s, 0) - s y + log(1 + exp(-|s|))`.
    """
    loss = jnp.maximum(scores, 0) - scores * label + jnp.log1p(jnp.exp(-jnp.abs(scores)))
    return jnp.where(valid, loss, 0).sum() / valid.sum()


def _deceive(_: LossOptions, made: Forecasts) -> Array:
    assert made.scores is not None
    valid = jnp.concatenate([scene.valid.reshape(-1) for scene in made.groups])
    return adversarial_loss(made.scores, made.label, valid)


TERMS = {
    "variety": Term("l2_weight", variety_loss),
    "adversarial": Term("adversarial_weight", _deceive),
}


def generator_loss(options: LossOptions, made: Forecasts) -> tuple[Array, dict[str, Array]]:
    """[] the weighted sum of the terms, and each term by name; terms of weight 0 are left out."""
    weights = {name: getattr(options, term.weight) for name, term in TERMS.items()}
    terms = {name: TERMS[name].value(options, made) for name, weight in weights.items() if weight}
    total = functools.reduce(operator.add, [weights[name] * terms[name] for name in terms])
    return total, terms


def refuse_no_loss(options: LossOptions) -> None:
    """Refuse options that leave all terms out.

    Raises:
        InputError: naming the weights that are 0.
    """
    weights = [term.weight for term in TERMS.values()]
    if not any(getattr(options, name) for name in weights):
        raise InputError(f"{' and '.join(weights)} are 0: nothing would be learned")
