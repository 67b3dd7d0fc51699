"""The losses of training: how the best of k forecasts is chosen, and what a loss is the sum of.

To add one: its function, an entry in `CRITERIA` or `TERMS`, and its options in `LossOptions`, which
are fields of every recipe.
"""

import dataclasses
import functools
import operator
from collections.abc import Callable, Sequence
from typing import Any, Literal, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from neurosym_jax.configuration import Count, Interval, NotNegative, Positive
from neurosym_jax.errors import InputError
from neurosym_jax.scene import AnyArray, Scene
from neurosym_jax.symbolic.qtc import qtc_c1
from neurosym_jax.symbolic.soft import soft_qtc_c1
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
    "symbol_log_scores",
]


@dataclasses.dataclass(frozen=True)
class LossOptions:
    """What a recipe says of its losses."""

    criterion: Literal["squared_displacement", "distance"] = "distance"
    """What best means: SGAN's squared displacements, or ADE and FDE each with its own best."""
    fde_weight: NotNegative = 0.5
    """Of the FDE term of the criterion `distance`."""
    weigh_scenes: Literal["equally", "by_agents"] = "by_agents"
    """SGAN's loss sums over scenes, whatever their size; the test's average runs over agents."""
    l2_weight: NotNegative = 1.0
    """Of the variety loss: the best of k forecasts by the criterion."""
    adversarial_weight: NotNegative = 0.0
    """0 trains no discriminator."""
    label_real: Interval = (0.7, 1.2)
    """Range of the smoothed label of real trajectories, one draw a step."""
    label_fake: Interval = (0.0, 0.3)
    symbols_weight: NotNegative = 0.0
    """Of the log score of the symbols to come."""
    symbols_samples: Count = 4
    """Forecasts whose soft symbols make a probability."""
    symbols_temperature: Positive = 0.05
    """Metres a step, of the soft symbols."""
    symbols_threshold: NotNegative = 0.05
    """Metres a step up to which a movement is none."""
    symbols_reach: Positive = 8.0
    """Metres; pairs who are further apart when they are observed last are left out."""

    @property
    def samples(self) -> int:
        """Forecasts besides the best that the loss looks at."""
        return self.symbols_samples if self.symbols_weight else 0


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
    """What the generator makes of a batch: what the terms of its loss are functions of."""

    groups: Groups
    futures: list[Array]
    """Of each group [C, scenes, slots, pred_len, 2] metres, the best by each row of the criterion.
    """
    samples: list[Array]
    """Of each group [m, scenes, slots, pred_len, 2] metres, forecasts that nothing has chosen."""
    scores: Array | None
    """[A] logits of all slots; None without a discriminator."""
    label: Array | float
    """[] what the discriminator is to take the forecast for."""


class Term(NamedTuple):
    """A term of the generator's loss; its metric is `g_` and its name."""

    weight: str
    """The option that is its weight; 0 leaves the term out."""
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
    """The test's own criteria of one scene: ADE and FDE of each sample, metres.

    Arguments as above, but positions. Returns [2, k], means over the scene's valid agents.
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
    """Those of `future [..., pred_len, 2]` after the position `last [..., 1, 2]`."""
    start = jnp.broadcast_to(last, (*future.shape[:-2], 1, 2))
    return jnp.diff(jnp.concatenate([start, future], axis=-2), axis=-2)


def safe_norm(vector: AnyArray) -> Array:
    """Euclidean norm over the last axis, with gradient zero where the vector is zero.

    NaN stays NaN: as a zero it would be the best of all errors.
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
    """[] the criterion of the best forecasts: future c is the best by row c."""
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


def symbol_log_scores(options: LossOptions, scene: Scene, samples: AnyArray) -> tuple[Array, Array]:
    """How improbable the symbols to come are by m forecasts of one scene.

    The probability of a symbol is the mean of its soft ones over the forecasts and of one uniform
    vote more, as `symbolic.forecast` smooths counts.

    Args:
        options: `symbols_...`.
        scene: with its future.
        samples: [m, N, pred_len, 2] metres relative to the scene's origin.

    Returns:
        [P, pred_len, 4] nats of q1 to q4 (QTC_C1) of all P = N (N - 1) / 2 pairs, and [P] bool:
        which of them are both valid and within reach.
    """
    first, second = np.triu_indices(scene.observed.shape[0], 1)
    last = jnp.asarray(scene.observed)[:, -1:]
    start = jnp.broadcast_to(last, (len(samples), *last.shape))
    paths = jnp.concatenate([start, samples], axis=2)
    truth = jnp.concatenate([last, scene.known_future], axis=1)
    step = options.symbols_threshold
    thresholds: dict[str, Any] = {"quantisation_factor": step, "side_quantisation_factor": step}
    soft = soft_qtc_c1(
        paths[:, first],
        paths[:, second],
        temperature=options.symbols_temperature,
        **thresholds,
    )
    found = qtc_c1(truth[first], truth[second], **thresholds)
    forecast = jnp.take_along_axis(soft.sum(axis=0), found[..., None] + 1, axis=-1)[..., 0]
    probability = (forecast + 1 / 3) / (len(samples) + 1)
    near = safe_norm(last[first, 0] - last[second, 0]) <= options.symbols_reach
    return -jnp.log(probability), near & scene.valid[first] & scene.valid[second]


def _symbols(options: LossOptions, made: Forecasts) -> Array:
    """[] nats: the mean log score of a symbol, of all pairs of a batch."""
    total = count = jnp.zeros(())
    of_scenes = jax.vmap(functools.partial(symbol_log_scores, options), in_axes=(0, 1))
    for scene, samples in zip(made.groups, made.samples):
        if samples.shape[2] > 1:
            scores, there = of_scenes(jax.tree.map(jnp.asarray, scene), samples)
            total = total + jnp.where(there[..., None, None], scores, 0).sum()
            count = count + there.sum() * scores[0, 0].size
    return total / jnp.maximum(count, 1)


TERMS = {
    "variety": Term("l2_weight", variety_loss),
    "adversarial": Term("adversarial_weight", _deceive),
    "symbols": Term("symbols_weight", _symbols),
}


def generator_loss(options: LossOptions, made: Forecasts) -> tuple[Array, dict[str, Array]]:
    """[] the weighted sum of the terms, and each of them by name; those of weight 0 left out."""
    weights = {name: getattr(options, term.weight) for name, term in TERMS.items()}
    terms = {name: TERMS[name].value(options, made) for name, weight in weights.items() if weight}
    total = functools.reduce(operator.add, [weights[name] * terms[name] for name in terms])
    return total, terms


def refuse_no_loss(options: LossOptions) -> None:
    """Refuse options that leave all terms out.

    Raises:
        InputError: naming their weights.
    """
    weights = [term.weight for term in TERMS.values()]
    if not any(getattr(options, name) for name in weights):
        raise InputError(f"{' and '.join(weights)} are 0: nothing would be learned")
