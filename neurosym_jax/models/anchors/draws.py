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

from neurosym_jax.models.anchors.config import computed_once
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
from neurosym_jax.runtime.programs import full_precision
from neurosym_jax.scene import Scene

__all__ = ["couple", "draw_apart", "draw_samples", "draw_scenes", "equal_points"]
__all__ += ["nearest", "pair_terms"]


PART = 8
"""Pairs of people whose points are compared at once, in memory that is near."""


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
        chosen = _place_among(ends, lots)
    if points.shape[1] > 1:
        near, present = nearest(points, jnp.asarray(scene.valid), weight)
        table, rows = pair_terms(points, scene, near, present, period)
        chosen = couple(chosen, near, table, rows, coupled, weight, even)
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
    people = jnp.arange(points.shape[1])
    within = jax.vmap(draw)(people)
    number = jnp.arange(count)
    lots = (number[None] + within[:, None]) / count
    ends = jnp.cumsum(weight, axis=1)[:, None]
    chosen = _place_among(ends, lots)
    return _take(points, chosen.T)


def _place_among(ends: Array, lots: Array) -> Array:
    """[...] points that `lots [...]` in [0, 1) fall on, whose probabilities end at `ends [..., P]`."""
    place = lots[..., None] * ends[..., -1:]
    return (ends[..., :-1] <= place).sum(axis=-1)


@full_precision
def couple(
    chosen: Array,
    near: Array,
    table: Array,
    rows: Array,
    key: Array,
    weight: Array | None = None,
    even: bool = True,
) -> Array:
    """[n, N] points of each person in n draws, chosen anew from `chosen [n, N]`, given the others'.

    `near [N, M]` are the people on whom a person depends, see `pair_terms` for `table
    [L, P, P]` and `rows [N, M]`. `weight [N, P]` says how probable each point is for a
    person alone.
    """
    count, agents = chosen.shape
    up_to = jnp.triu(jnp.ones(table.shape[-2:]))
    # A person whom no neighbour influences is not drawn again.
    is_bound = (rows < len(table) - 1).any(axis=1)
    turns = jnp.argsort(~is_bound)
    number = is_bound.sum()

    def sweep(round: Array, chosen: Array) -> Array:
        lots = _lots(jax.random.fold_in(key, round), agents, count, even)

        def choose(turn: Array, chosen: Array) -> Array:
            agent = turns[turn]
            others = chosen[:, near[agent]]
            cost = table[rows[agent], others].sum(1)  # [n, P]
            if weight is not None:
                cost = jnp.where(weight[agent] > 0, cost, jnp.inf)
            least = cost.min(1, keepdims=True)
            share = jnp.exp(least - cost)
            if weight is not None:
                share = weight[agent] * share
            ends = share @ up_to
            point = _place_among(ends, lots[agent])
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
        offset = jax.random.uniform(within, (count,))
        lots = (part + offset) / count
        return jnp.minimum(lots, 1 - 1e-6)  # Rounding may reach 1.

    return jax.vmap(draw)(jnp.arange(agents))


@full_precision
def pair_terms(
    points: Array, scene: Scene, near: Array, present: Array, period: float
) -> tuple[Array, Array]:
    """How many nats less probable two people's points make each other: [L, P, P], and [N, M] rows.

    Of each point of `near [N, M]` (second axis) and of the person itself (third), where
    `present [N, M]`; `points` are [P, N, T, 2] metres, with steps of `period` seconds.
    Most pairs neither meet nor walk together: theirs is the last row, of zeros.
    """
    observed, offset, _ = repair_tracks(jnp.asarray(scene.observed), period)
    together = _together(observed, near, present, period)
    moved = points - offset[:, None] - observed[:, -1, None]

    agents, most = near.shape
    size = agents * most
    may_act = _can_meet(points, near) | (together > 0)
    related = present & may_act
    # Two who are near to each other are compared once.
    own = jnp.arange(agents)[:, None]
    backward = near[near] == own[..., None]
    twice = backward.any(axis=2) & (near < own)
    compared = (related & ~twice).ravel()
    number = jnp.cumsum(compared)
    pairs = jnp.searchsorted(number, jnp.arange(1, size + PART))
    pairs = jnp.minimum(pairs, size - 1)
    person = pairs // most
    other = near.ravel()[pairs]
    hold = jnp.where(compared, together.ravel(), 0)[pairs]

    half = size + PART
    count = len(points)

    def compare(part: Array, terms: tuple[Array, Array]) -> tuple[Array, Array]:
        table, acts = terms
        begin = part * PART
        slots = begin + jnp.arange(PART)
        first, second = person[slots], other[slots]
        overlap = _overlaps(points, first, second)
        parted = jnp.minimum(_partings(moved, first, second) / FAR, 1)
        bond = COHESION * hold[slots, None, None]
        cost = REPULSION * overlap + bond * parted
        table = jax.lax.dynamic_update_slice_in_dim(table, cost, begin, 0)
        back = cost.swapaxes(1, 2)
        table = jax.lax.dynamic_update_slice_in_dim(table, back, half + begin, 0)
        some = cost.any(axis=(1, 2))
        return table, jax.lax.dynamic_update_slice_in_dim(acts, some, begin, 0)

    table = jnp.zeros((2 * half + 1, count, count))
    parts = -(-number[-1] // PART)
    start = table, jnp.zeros(half, bool)
    table, acts = jax.lax.fori_loop(0, parts, compare, start)

    rows = number.reshape(near.shape) - 1
    # Of two who are compared once, the row of the other who has it.
    place = backward.argmax(axis=2)[..., None]
    turned = jnp.take_along_axis(rows[near], place, 2)[..., 0]
    row_compared = jnp.where(twice, turned, rows)
    acts_there = related & acts[row_compared]
    rows = jnp.where(twice, half + turned, rows)
    return table, jnp.where(acts_there, rows, 2 * half)


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


def _together(observed: Array, near: Array, present: Array, period: float) -> Array:
    """[N, M] how much each person and `near [N, M]` who are `present [N, M]` hold each other."""
    companionship = _companionship(observed, near, period)
    companionship = jnp.where(present, companionship, 0)
    total = jnp.maximum(companionship.sum(1), 1)
    # Of a stream of people, all hold a person as one companion does.
    return companionship / jnp.maximum(total[:, None], total[near])


def _companionship(observed: Array, near: Array, period: float) -> Array:
    """[N, M] how much each person walks together with `near [N, M]`, 0 to 1."""
    last = observed[:, -1]
    velocity = (last - observed[:, -4]) / (3 * period)
    distance, difference = COMPANY
    offset = last[:, None] - last[near]
    change = velocity[:, None] - velocity[near]
    square_offset = jnp.square(offset / distance).sum(-1)
    square_change = jnp.square(change / difference).sum(-1)
    companionship = jnp.exp(-(square_offset + square_change))
    return jnp.where(companionship > 0.02, companionship, 0)


def _can_meet(points: Array, near: Array) -> Array:
    """[N, M] whether boxes around the ways of a person and of `near [N, M]` overlap."""
    low, high = points.min(axis=0), points.max(axis=0)  # [N, T, 2]
    # From each step to the next.
    low = low.at[:, 1:].min(low[:, :-1])
    high = high.at[:, 1:].max(high[:, :-1])
    gap = jnp.maximum(low[:, None] - high[near], low[near] - high[:, None])
    gap = jnp.maximum(gap, 0)
    square = jnp.square(gap).sum(axis=-1)
    return (square < DISTANCE**2).any(axis=-1)


def _partings(moved: Array, first: Array, second: Array) -> Array:
    """[L, P, P] metres by which the offset of two people changes, root mean square over steps.

    Of each point of the `second [L]` (second axis) and the `first [L]`; `moved [P, N, T,
    2]` are from the last position.
    """
    count, people, steps, _ = moved.shape
    ways = moved.swapaxes(0, 1).reshape(people, count, -1)
    square = jnp.square(ways).sum(-1)
    product = jnp.einsum("lqd,lpd->lqp", ways[second], ways[first])
    squares = square[second][..., None] + square[first][:, None]
    gap = jnp.maximum(squares - 2 * product, 0)
    return jnp.sqrt(gap / steps)


def _overlaps(points: Array, first: Array, second: Array) -> Array:
    """[L, P, P] how far each point of the `second [L]` (second axis) and the `first` overlap.

    `points` are [P, N, T, 2] metres. Between two steps, offsets change along a straight
    line.
    """
    ways = jnp.transpose(points, (2, 3, 1, 0))  # [T, 2, N, P]
    own, others = computed_once((ways[:, :, first], ways[:, :, second]))
    least: Any = jnp.inf
    before = None
    for step, other in zip(own, others):
        x, y = step[:, :, None] - other[..., None]
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
