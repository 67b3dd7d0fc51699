"""The network's points and what people did here, as one distribution of each person.

A component is the network alone (the first), or what one kernel recalls: the ways that
people went, the errors that the network made, or points halfway between both. Where a
kernel recalls few people, the rest of its probability is the network's. Any mixture of
the components has an energy score that follows from two small arrays: how far each
component lies from the truth, and how far the components lie apart.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from neurosym_jax.models.place.memory import Recall
from neurosym_jax.runtime.programs import full_precision
from neurosym_jax.scene import AnyArray, Scene

__all__ = ["Remembered", "distances_apart", "energy", "errors", "remembered"]


DRAWN = 32
"""Most ways that a person's draws take from: pairs of people are compared in all of them."""


class Remembered(NamedTuple):
    """What people did here before, as an input of `Forecaster.distribution`."""

    future: AnyArray
    """[U, N, T, 2] positions in the frame of the scene, errors of the network, or halves of
    positions, metres."""
    share: AnyArray
    """[U, N] their probabilities for each person; what is left to 1 is the network's."""
    mean_part: AnyArray
    """[U, N] the part of the mean of the network's points that is added, see `Recall`."""

    def beside(
        self, points: Array, part: Array | int, parts: int
    ) -> tuple[Array, Array]:
        """`points [P, N, T, 2]` with the memory's, and the probability of each, [N, P'].

        A distribution that is drawn in `parts` takes each point of the memory in one of
        them, so that a part has P + U / `parts` points.
        """
        own_points = len(points)
        people = self.share.shape[1]
        future = self._positions(points)
        future = future.reshape(-1, parts, *future.shape[1:])[:, part]
        share = self.share.reshape(-1, parts, people)[:, part]
        # Each part has the whole share, where it has a point of the memory.
        whole = self.share.sum(axis=0)
        total = share.sum(axis=0)
        share = share * whole / jnp.maximum(total, 1e-9)
        rest = (1 - share.sum(axis=0)) / own_points
        own = jnp.broadcast_to(rest, (own_points, people))
        weight = jnp.concatenate([own, share])
        together = jnp.concatenate([points, future])
        return together, weight.T

    def among(self, draws: Array, scene: Scene, key: Array, count: int) -> Array:
        """[count, N, T, 2] `draws [n, N, T, 2]`, some replaced by the memory's points.

        Each point replaces its share of a person's draws. Which, depends on `key` and
        the identity of the scene.
        """
        for part in scene.identity:
            key = jax.random.fold_in(key, part)
        shift, order = jax.random.split(key)
        positions = self._positions(draws)
        times = -(-count // len(draws))  # rounded up
        draws = jnp.repeat(draws, times, axis=0)[:count]
        people = draws.shape[1]
        # Lots of a person, one in each `count`-th part of [0, 1), in random order.
        number = jnp.arange(count)[:, None]
        lot = (number + jax.random.uniform(shift, (people,))) / count
        lot = jax.random.permutation(order, lot, axis=0, independent=True)

        ends = jnp.cumsum(self.share, axis=0)
        point = (ends[:, None] <= lot).sum(axis=0)  # [count, N]
        last = len(ends) - 1
        row = jnp.minimum(point, last)
        future = positions[row, jnp.arange(people)]
        is_memory = point <= last
        return jnp.where(is_memory[..., None, None], future, draws)

    def _positions(self, points: Array) -> Array:
        """[U, N, T, 2] where a person will be by the memory, beside `points [P, N, T, 2]`."""
        part = jnp.asarray(self.mean_part)[..., None, None]
        return jnp.asarray(self.future) + part * points.mean(axis=0)


@jax.jit
@full_precision
def remembered(recall: Recall, shares: Array, last: Array) -> Remembered:
    """The input of `Forecaster.distribution` for N people.

    Of more than `DRAWN` ways the most probable are kept, with the probability of all.

    Args:
        recall: of these people.
        shares: [N, 1 + K] probability of each component.
        last: [N, 2] last positions in the frame of the scene.
    """
    share = jnp.einsum("nk,nku->nu", shares[:, 1:], recall.weight)
    total = share.sum(axis=1, keepdims=True)
    share, kept = jax.lax.top_k(share, min(DRAWN, share.shape[1]))
    kept_total = share.sum(axis=1, keepdims=True)
    share *= total / jnp.maximum(kept_total, 1e-9)
    future = jnp.take_along_axis(recall.onward, kept[..., None, None], axis=1)
    mean_part = recall.mean_part[kept]
    # The mean of the network's points begins at the last position itself.
    own_part = (1 - mean_part)[..., None, None]
    future = future + own_part * last[:, None, None]
    return Remembered(
        future=future.swapaxes(0, 1), share=share.T, mean_part=mean_part.T
    )


@jax.jit
@full_precision
def distances_apart(offsets: Array, recall: Recall) -> Array:
    """[N, 1 + K, 1 + K] mean distances between draws of two components, metres.

    `offsets [P, N, T, 2]` are the network's points, from the last position. A distance
    is the root mean square over steps.
    """
    points = _points(offsets, recall)
    # Products lose less of points that lie around 0.
    points = points - points.mean(axis=1, keepdims=True)
    product = jnp.einsum("nid,njd->nij", points, points)
    square = jnp.square(points).sum(axis=-1)
    squares = square[:, :, None] + square[:, None]
    gap = jnp.maximum(squares - 2 * product, 0)
    steps = offsets.shape[2]
    distance = jnp.sqrt(gap / steps)
    weight = _weights(len(offsets), recall)
    return jnp.einsum("nci,nij,ndj->ncd", weight, distance, weight)


@jax.jit
@full_precision
def errors(offsets: Array, recall: Recall, future: Array) -> Array:
    """[N, 1 + K] mean distances of the components from `future [N, T, 2]`, metres.

    `future` holds offsets from the last position, as `offsets [P, N, T, 2]` do.
    """
    truth = future.reshape(len(future), 1, -1)
    points = _points(offsets, recall)
    gap = jnp.square(points - truth).sum(axis=-1)
    steps = offsets.shape[2]
    distance = jnp.sqrt(gap / steps)
    weight = _weights(len(offsets), recall)
    return jnp.einsum("nci,ni->nc", weight, distance)


def energy(shares: np.ndarray, error: np.ndarray, distances: np.ndarray) -> np.ndarray:
    """[N] energy scores of mixtures of C components, metres.

    Args:
        shares: [N, C] probabilities of the components.
        error: [N, C] see `errors`.
        distances: [N, C, C] see `distances_apart`.
    """
    within = np.einsum("ncd,nc,nd->n", distances, shares, shares)
    return (error * shares).sum(axis=1) - within / 2


def _points(offsets: Array, recall: Recall) -> Array:
    """[N, P + U, T * 2] points of all components."""
    own = offsets.swapaxes(0, 1)
    ways = recall.ways(offsets.mean(axis=0))
    points = jnp.concatenate([own, ways], axis=1)
    return points.reshape(*points.shape[:2], -1)


def _weights(count: int, recall: Recall) -> Array:
    """[N, 1 + K, P + U] probability of each point in each component, of P = `count`."""
    people, _components, points = recall.weight.shape
    rest = 1 - recall.weight.sum(axis=2)
    whole = jnp.ones((people, 1))
    network = jnp.concatenate([whole, rest], axis=1)
    own = jnp.repeat(network[..., None] / count, count, axis=2)
    nothing = jnp.zeros((people, 1, points))
    others = jnp.concatenate([nothing, recall.weight], axis=1)
    return jnp.concatenate([own, others], -1)
