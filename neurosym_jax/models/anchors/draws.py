"""Draws of scenes: from samples that have probabilities, or from each person's own points.

Which point of one person goes with which of another is free: whatever the pairing, every person's
points are used equally often. Independent pairings put people onto each other. So they are paired
anew by Metropolis steps, whose stationary distribution is that of independent people times
exp(-`REPULSION` x overlap) for each pair. Nothing is learned, and nobody's own forecast changes.
"""

import functools

import jax
import jax.numpy as jnp
from jax import Array

from neurosym_jax.models.anchors.frames import length

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
    draws = jnp.take_along_axis(points, chosen[..., None, None], axis=0)
    return separate(draws, valid, together)


def separate(draws: Array, valid: Array, key: Array) -> Array:
    """`draws [n, N, T, 2]` with each person's trajectories exchanged between draws.

    People then overlap less in one draw. `valid [N]` is False for padding.
    """
    count, agents = draws.shape[:2]
    if count < 2 or agents < 2:
        return draws
    # Step by step, because of a crowd all steps of all pairs would not fit into memory.
    means = draws.mean(axis=0).swapaxes(0, 1)  # [T, N, 2]
    gaps = [jnp.square(mean[:, None] - mean).sum(-1) for mean in means]
    clearance = functools.reduce(jnp.minimum, gaps)
    others = valid & ~jnp.eye(agents, dtype=bool)
    nearest, near = jax.lax.top_k(jnp.where(others, -clearance, -jnp.inf), min(agents - 1, NEAREST))
    present = jnp.isfinite(nearest)

    def exchange(draws: Array, turn: tuple[Array, Array]) -> tuple[Array, None]:
        sweep, agent = turn  # Not their number, which would change with padding.
        turn_key = jax.random.fold_in(jax.random.fold_in(key, sweep), agent)
        order_key, lot_key = jax.random.split(turn_key)
        order = jax.random.uniform(order_key, (count,)).argsort()
        # Neighbours in a random order are partners; of an odd number the last is its own.
        ahead = order.at[: count // 2 * 2].set(
            order[: count // 2 * 2].reshape(-1, 2)[:, ::-1].reshape(-1)
        )
        partner = jnp.zeros_like(order).at[order].set(ahead)
        mine, others_draws = draws[:, agent], draws[:, near[agent]]

        def overlaps(mine: Array) -> Array:
            offset = mine[:, None] - others_draws
            halfway = (offset[..., 1:, :] + offset[..., :-1, :]) / 2
            distance = length(jnp.concatenate([offset, halfway], -2)).min(-1)
            return jnp.where(present[agent], jnp.maximum(1 - distance / DISTANCE, 0), 0).sum(-1)

        increase = overlaps(mine[partner]) - overlaps(mine)
        increase = increase + increase[partner]
        lot = jax.random.uniform(lot_key, (count,))
        lot = lot[jnp.minimum(jnp.arange(count), partner)]  # One for both partners.
        accepted = jnp.log(lot) < -REPULSION * increase
        mine = jnp.where(accepted[:, None, None], mine[partner], mine)
        return draws.at[:, agent].set(mine), None

    sweeps, people = jnp.divmod(jnp.arange(SWEEPS * agents), agents)
    return jax.lax.scan(exchange, draws, (sweeps, people))[0]
