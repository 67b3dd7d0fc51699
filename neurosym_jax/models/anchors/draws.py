"""Draws of scenes: from samples that have probabilities, or from each person's own points.

A scene takes a point of each person. Its probability is that of independent people,
times what each pair of people says (a Markov random field): scenes in which two overlap
are improbable, and those in which two who walk together part. Draws are made from it by
Gibbs sampling. So a person's points are equally probable only for a person who is
alone. Nothing is learned here.
"""

from typing import Any

import jax
import jax.numpy as jnp
from jax import Array

from neurosym_jax.models.anchors.frames import computed_once
from neurosym_jax.models.anchors.pair_constants import (
    COHESION,
    COMPANY,
    DISTANCE,
    FAR,
    NEAREST,
    REPULSION,
    SWEEPS,
)
from neurosym_jax.models.tracking_errors import repair_tracks
from neurosym_jax.runtime.precision import full_precision
from neurosym_jax.scene import Scene

__all__ = ["couple", "draw_apart", "draw_samples", "draw_scenes", "equal_points"]
__all__ += ["nearest", "pair_terms"]


def draw_samples(
    samples: Array, probability: Array, key: Array, count: int, even: bool = True
) -> Array:
    """[count, N, T, 2] of `samples [k, N, T, 2]`, each as often as its `probability [k]` says.

    A sample is drawn `count` times its probability, rounded up or down at random;
    without `even`, draws are independent.
    """
    place = (jnp.arange(count) + jax.random.uniform(key)) / count
    if not even:
        place = jax.random.uniform(key, (count,))
    ends = jnp.cumsum(probability)
    chosen = jnp.searchsorted(ends, place)
    # Rounding may leave the last end below 1.
    chosen = jnp.minimum(chosen, len(samples) - 1)
    return samples[chosen]


def draw_apart(samples: Array, key: Array, count: int, even: bool = True) -> Array:
    """[count, N, T, 2] of `samples [k, N, T, 2]`, of which each person has one of their own.

    A person's samples are drawn about equally often; without `even`, draws are
    independent.
    """
    lots = _lots(key, samples.shape[1], count, even).T
    chosen = (lots * len(samples)).astype(int)
    return _take(samples, chosen)


def _take(points: Array, chosen: Array) -> Array:
    """[count, N, T, 2] of `points [P, N, T, 2]`, those that are `chosen [count, N]`."""
    return jnp.take_along_axis(points, chosen[..., None, None], axis=0)


def draw_scenes(
    points: Array,
    scene: Scene,
    key: Array,
    count: int,
    period: float,
    weight: Array | None = None,
    even: bool = True,
) -> Array:
    """[count, N, T, 2] equally probable futures of `scene`, of each person's `points [P, N, T, 2]`.

    Steps are of `period` seconds. Somebody alone has each point about as often as its
    `weight [N, P]` says; by default all are the same. Without `even`, draws are
    independent.
    """
    independent, coupled = jax.random.split(key)
    lots = _lots(independent, points.shape[1], count, even).T
    if weight is None:
        chosen = (lots * len(points)).astype(int)
    else:
        ends = jnp.cumsum(weight, axis=1)
        place = lots[..., None] * ends[:, -1:]
        chosen = (ends[:, :-1] <= place).sum(axis=2)
    if points.shape[1] > 1:
        near, present = nearest(points, jnp.asarray(scene.valid), weight)
        overlap, parting = pair_terms(points, scene, near, present, period)
        table = REPULSION * overlap + COHESION * parting
        chosen = couple(chosen, near, table, coupled, weight, even)
    return _take(points, chosen)


def equal_points(points: Array, weight: Array, key: Array, count: int) -> Array:
    """[count, N, T, 2] equally probable points, of `points [P, N, T, 2]` by their `weight [N, P]`.

    Pairs of people are compared in all of their points, so many are costly. Each of
    these takes an equal part of the probability, in the order of the points: those of
    equal weight remain what they are where `count` is their number. Draws that take
    them are not independent of each other.
    """

    def draw(agent: Array) -> Array:
        agent_key = jax.random.fold_in(key, agent)
        return jax.random.uniform(agent_key, maxval=1 - 1e-6)

    # One for all points of a person: so none is taken twice whose part is less than one.
    within = jax.vmap(draw)(jnp.arange(points.shape[1]))
    place = (jnp.arange(count)[None] + within[:, None]) / count
    ends = jnp.cumsum(weight, axis=1)[:, None]
    chosen = (ends[..., :-1] <= place[..., None] * ends[..., -1:]).sum(axis=2)
    return _take(points, chosen.T)


@full_precision
def couple(
    chosen: Array,
    near: Array,
    table: Array,
    key: Array,
    weight: Array | None = None,
    even: bool = True,
) -> Array:
    """[n, N] points of each person in n draws, chosen anew from `chosen [n, N]`, given the others'.

    `near [N, M]` are the people on whom a person depends, `table [N, M, P, P]` how many
    nats less probable each point of theirs (third axis) makes each of the person's
    (fourth). `weight [N, P]` says how probable each point is for a person alone.
    """
    count, agents = chosen.shape
    slots = jnp.arange(near.shape[1])
    up_to = jnp.triu(jnp.ones(table.shape[-2:]))
    # A person whom no neighbour influences is not drawn again.
    is_bound = table.any(axis=(1, 2, 3))
    turns = jnp.argsort(~is_bound)
    number = is_bound.sum()

    def sweep(round: Array, chosen: Array) -> Array:
        lots = _lots(jax.random.fold_in(key, round), agents, count, even)

        def choose(turn: Array, chosen: Array) -> Array:
            agent = turns[turn]
            others = chosen[:, near[agent]]
            cost = table[agent, slots, others].sum(1)  # [n, P]
            if weight is not None:
                cost = jnp.where(weight[agent] > 0, cost, jnp.inf)
            share = jnp.exp(cost.min(1, keepdims=True) - cost)
            if weight is not None:
                share = weight[agent] * share
            ends = share @ up_to
            place = lots[agent, :, None] * ends[:, -1:]
            point = (ends[:, :-1] <= place).sum(1)
            return chosen.at[:, agent].set(point)

        return jax.lax.fori_loop(0, number, choose, chosen)

    return jax.lax.fori_loop(0, SWEEPS, sweep, chosen)


def _lots(key: Array, agents: int, count: int, even: bool) -> Array:
    """[agents, count] numbers in [0, 1), one in each `count`-th part of it, in random order.

    Without `even`, they are independent of each other.

    Those of an agent depend on its slot alone, so that padding changes nothing.
    """

    def draw(agent: Array) -> Array:
        agent_key = jax.random.fold_in(key, agent)
        order, within = jax.random.split(agent_key)
        if not even:
            return jax.random.uniform(within, (count,))
        part = jax.random.uniform(order, (count,)).argsort()
        lots = (part + jax.random.uniform(within, (count,))) / count
        return jnp.minimum(lots, 1 - 1e-6)  # Rounding may reach 1.

    return jax.vmap(draw)(jnp.arange(agents))


@full_precision
def pair_terms(
    points: Array, scene: Scene, near: Array, present: Array, period: float
) -> tuple[Array, Array]:
    """[N, M, P, P] twice, 0 to 1: how far two people overlap, and how far companions part.

    Of each point of `near [N, M]` (third axis) and of the person itself (fourth), where
    `present [N, M]`; `points` are [P, N, T, 2] metres, with steps of `period` seconds.
    """
    observed, offset, _ = repair_tracks(jnp.asarray(scene.observed), period)
    companionship = jnp.where(present, _companionship(observed, near, period), 0)
    total = jnp.maximum(companionship.sum(1), 1)
    # Of a stream of people, all hold a person as one companion does.
    share = companionship / jnp.maximum(total[:, None], total[near])
    parting = _partings(points - offset[:, None], observed[:, -1], near)
    parted = jnp.minimum(parting / FAR, 1)
    overlap = _overlaps(points, near)
    overlap = jnp.where(present[..., None, None], overlap, 0)
    return overlap, share[..., None, None] * parted


@full_precision
def nearest(
    points: Array, valid: Array, weight: Array | None = None
) -> tuple[Array, Array]:
    """[N, M] the people who come nearest to each, and whether both are there.

    Of mean paths of `points [P, N, T, 2]`, with their `weight [N, P]` if there is one;
    `valid [N]` is False for padding.
    """
    agents = len(valid)
    if weight is None:
        means = points.mean(axis=0).swapaxes(0, 1)  # [T, N, 2]
    else:
        means = jnp.einsum("np,pntc->tnc", weight, points)
    # Step by step, because of a crowd all steps of all pairs would not fit into memory.
    clearance: Any = jnp.inf
    for mean in means:
        gap = jnp.square(mean[:, None] - mean).sum(-1)
        clearance = jnp.minimum(clearance, gap)
    others = valid & ~jnp.eye(agents, dtype=bool)
    score = jnp.where(others, -clearance, -jnp.inf)
    score, near = jax.lax.top_k(score, min(agents - 1, NEAREST))
    return near, jnp.isfinite(score) & valid[:, None]


def _companionship(observed: Array, near: Array, period: float) -> Array:
    """[N, M] how much each person walks together with `near [N, M]`, 0 to 1."""
    last = observed[:, -1]
    velocity = (last - observed[:, -4]) / (3 * period)
    distance, difference = COMPANY
    offset = (last[:, None] - last[near]) / distance
    change = (velocity[:, None] - velocity[near]) / difference
    square = jnp.square(offset).sum(-1) + jnp.square(change).sum(-1)
    companionship = jnp.exp(-square)
    return jnp.where(companionship > 0.02, companionship, 0)


def _partings(points: Array, last: Array, near: Array) -> Array:
    """[N, M, P, P] metres by which the offset of two people changes, root mean square over steps.

    Of each point of `near [N, M]`, third axis, and of the person itself.
    """
    count, agents, steps, _ = points.shape
    moved = (points - last[:, None]).swapaxes(0, 1)
    moved = moved.reshape(agents, count, -1)
    square = jnp.square(moved).sum(-1)
    product = jnp.einsum("nmqd,npd->nmqp", moved[near], moved)
    squares = square[near][..., None] + square[:, None, None]
    gap = jnp.maximum(squares - 2 * product, 0)
    return jnp.sqrt(gap / steps)


def _overlaps(points: Array, near: Array) -> Array:
    """[N, M, P, P] how far each point of `near [N, M]`, third axis, and of a person overlap.

    Between two steps, offsets change along a straight line.
    """
    own = jnp.transpose(points, (2, 3, 1, 0))  # [T, 2, N, P]
    own, others = computed_once((own, own[:, :, near]))
    least: Any = jnp.inf
    before = None
    for step, other in zip(own, others):
        x, y = step[:, :, None, None] - other[..., None]
        before_x, before_y = before or (x, y)
        dx = before_x - x
        dy = before_y - y
        # The share of the way back to the step before at which they are nearest.
        along = x * dx + y * dy
        length = dx * dx + dy * dy + 1e-12
        back = jnp.clip(-along / length, 0, 1)
        square = jnp.square(x + back * dx) + jnp.square(y + back * dy)
        least = jnp.minimum(least, square)
        before = x, y
    return jnp.maximum(1 - jnp.sqrt(least) / DISTANCE, 0)
