"""Draws of scenes: from samples that have probabilities, or from each person's own points.

Which point of one person goes with which of another is free: whatever the pairing, every person's
points are used equally often. Independent pairings put people onto each other. So they are paired
anew by Metropolis steps, whose stationary distribution is that of independent people times
exp(-`REPULSION` x overlap) for each pair. Nothing is learned, and nobody's own forecast changes.
"""

import functools
from typing import Any

import jax
import jax.numpy as jnp
from jax import Array

__all__ = ["draw_samples", "draw_scenes", "separate"]

DISTANCE = 0.3
"""Distance of two people's centres below which they overlap, metres."""
REPULSION = 40.0
"""How much less probable a scene is for each complete overlap of two people, in nats."""
SWEEPS = 16
"""Times that each person's points are paired anew."""
NEAREST = 16
"""Neighbours with whom a person may overlap: those who come nearest to its mean path."""


def draw_samples(samples: Array, probability: Array, key: Array, count: int) -> Array:
    """[count, N, T, 2] of `samples [k, N, T, 2]`, each as often as its `probability [k]` says.

    A sample is drawn `count` times its probability, rounded up or down at random.
    """
    place = (jnp.arange(count) + jax.random.uniform(key)) / count
    chosen = jnp.searchsorted(jnp.cumsum(probability), place)
    return samples[jnp.minimum(chosen, len(samples) - 1)]


def draw_scenes(points: Array, valid: Array, key: Array, count: int) -> Array:
    """[count, N, T, 2] equally probable scenes of `points [P, N, T, 2]`, see `separate`.

    Each point of a person is drawn equally often, up to one. `valid [N]` is False for padding.
    """
    independent, together = jax.random.split(key)
    rounds = -(-count // len(points))

    def order(slot: Array) -> Array:
        lots = jax.random.uniform(jax.random.fold_in(independent, slot), (rounds, len(points)))
        return lots.argsort(axis=1).reshape(-1)[:count]

    chosen = jax.vmap(order, out_axes=1)(jnp.arange(len(valid)))
    chosen = separate(points, chosen, valid, together)
    return jnp.take_along_axis(points, chosen[..., None, None], axis=0)


def separate(points: Array, chosen: Array, valid: Array, key: Array) -> Array:
    """`chosen [n, N]` of `points [P, N, T, 2]` with each person's choices exchanged between draws.

    People then overlap less in one draw. `valid [N]` is False for padding.
    """
    count, agents = chosen.shape
    if count < 2 or agents < 2:
        return chosen
    near, present = _nearest(points, valid)
    table = jnp.where(present[..., None, None], _overlaps(points, near), 0)
    table = jax.lax.stop_gradient(table)
    slots, draws = jnp.arange(near.shape[1]), jnp.arange(count)
    # Whoever can overlap with nobody has no turn.
    crowded = table.any(axis=(1, 2, 3))
    turns, number = jnp.argsort(~crowded), crowded.sum()

    def sweep(key: Array, chosen: Array) -> Array:
        # By the person, so that padding changes nothing.
        keys = jax.vmap(functools.partial(jax.random.fold_in, key))(jnp.arange(agents))
        lots = jax.vmap(lambda key: jax.random.uniform(key, (count + 1,)))(keys)

        def exchange(turn: Array, chosen: Array) -> Array:
            agent = turns[turn]
            lot, pivot = lots[agent, :-1], (lots[agent, -1] * count).astype(int)
            # Draws are partners whose numbers have a sum drawn at random; some are their own.
            partner = (pivot - draws) % count
            mine, theirs = chosen[:, agent], chosen[:, near[agent]]
            both = jnp.stack([mine, mine[partner]])
            now, then = table[agent, slots, both[..., None], theirs].sum(-1)
            increase = then - now
            increase = increase + increase[partner]
            # One lot for both partners.
            accepted = jnp.log(lot[jnp.minimum(draws, partner)]) < -REPULSION * increase
            return chosen.at[:, agent].set(both[accepted.astype(int), draws])

        return jax.lax.fori_loop(0, number, exchange, chosen)

    keys = jax.random.split(key, SWEEPS)
    return jax.lax.fori_loop(0, SWEEPS, lambda round, chosen: sweep(keys[round], chosen), chosen)


def _nearest(points: Array, valid: Array) -> tuple[Array, Array]:
    """[N, M] the people who come nearest to each, and whether both are there."""
    agents = len(valid)
    means = points.mean(axis=0).swapaxes(0, 1)  # [T, N, 2]
    # Step by step, because of a crowd all steps of all pairs would not fit into memory.
    gaps = [jnp.square(mean[:, None] - mean).sum(-1) for mean in means]
    clearance = functools.reduce(jnp.minimum, gaps)
    others = valid & ~jnp.eye(agents, dtype=bool)
    nearest, near = jax.lax.top_k(jnp.where(others, -clearance, -jnp.inf), min(agents - 1, NEAREST))
    return near, jnp.isfinite(nearest) & valid[:, None]


def _overlaps(points: Array, near: Array) -> Array:
    """[N, M, P, P] how far each point of a person and of its neighbours `near [N, M]` overlap."""
    steps = jnp.transpose(points, (2, 3, 1, 0))  # [T, 2, N, P]
    least: Any = jnp.inf
    before = None
    for step in steps:
        offset = [
            place[:, None, :, None] - place[near][:, :, None, :] for place in (step[0], step[1])
        ]
        halfway = [(now + then) / 2 for now, then in zip(offset, before or offset)]
        for east, north in (offset, halfway):
            least = jnp.minimum(least, east * east + north * north)
        before = offset
    return jnp.maximum(1 - jnp.sqrt(jnp.maximum(least, 1e-12)) / DISTANCE, 0)
