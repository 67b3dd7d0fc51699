"""An endless stream of training batches that depends on (seed, step) only.

A batch has a fixed number of scenes of every size class, in proportion to the data (stratified by
size), so that one compiled step serves all batches. Within a class every scene comes once before
any comes again.
"""

import dataclasses
import itertools
import math
from collections.abc import Sequence

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from neurosym_jax.data.windows import Windows, gather_scenes
from neurosym_jax.scene import AnyArray, Scene

__all__ = ["Groups", "SceneStream", "gather_cropped", "merge", "size_classes", "split"]

Groups = tuple[Scene, ...]
"""A batch: one Scene `[scenes, slots, ...]` for each size class, computed on together."""

COST_OF_A_CLASS = 1000
"""Pairs that another class must save: each class is compiled and looped over separately."""


class SceneStream:
    """Batches of about `batch_scenes` scenes of `windows`.

    Scenes of more than `max_agents` agents are cropped to a random agent and its nearest
    neighbours.
    """

    def __init__(
        self, windows: Windows, batch_scenes: int, seed: int, max_agents: int | None = None
    ):
        self._windows, self._seed = windows, seed
        sizes = windows.sizes if max_agents is None else np.minimum(windows.sizes, max_agents)
        classes = size_classes(sizes, batch_scenes)
        class_of = np.searchsorted(classes, sizes)
        self._slots = classes.tolist()
        self._members = [np.flatnonzero(class_of == index) for index in range(len(classes))]
        counts = np.array([len(members) for members in self._members])
        self._quotas = quota(counts, len(sizes), batch_scenes).tolist()

    def steps(self, first: int, count: int) -> Groups:
        """`count` batches from step `first`: a Scene `[count, quota, slots, ...]` of each class."""
        return tuple(self._of_class(index, first, count) for index in range(len(self._slots)))

    def _of_class(self, index: int, first: int, count: int) -> Scene:
        members, quota, seed = self._members[index], self._quotas[index], self._seed
        place = np.arange(first * quota, (first + count) * quota)
        epoch, within = np.divmod(place, len(members))
        chosen = np.empty(len(place), int)
        for number in np.unique(epoch):
            order = np.random.default_rng([seed, index, number]).permutation(members)
            chosen[epoch == number] = order[within[epoch == number]]
        # Drawn step by step: the result does not depend on how many steps a call asks for.
        focus = [
            np.random.default_rng([seed, index, step, 1]).random(quota)
            for step in range(first, first + count)
        ]
        scenes = gather_cropped(self._windows, chosen, self._slots[index], np.concatenate(focus))
        return jax.tree.map(lambda array: array.reshape(count, quota, *array.shape[1:]), scenes)


def size_classes(sizes: np.ndarray, batch_scenes: int) -> np.ndarray:
    """[C] padded sizes for scenes of `sizes` [S], ascending; a scene takes the smallest that fits.

    A batch has a `quota` of every class, and pooling costs the square of each padded size. The
    classes minimise the sum of costs (dynamic programming over the sizes).
    """
    values, counts = np.unique(sizes, return_counts=True)
    below = np.concatenate([[0], np.cumsum(counts)])
    best, cut = np.zeros(len(values) + 1), np.zeros(len(values) + 1, int)
    for end in range(1, len(values) + 1):
        # One class from each possible beginning to `end`, after the best classes before it.
        members = below[end] - below[:end]
        pairs = quota(members, len(sizes), batch_scenes) * float(values[end - 1]) ** 2
        costs = best[:end] + pairs + COST_OF_A_CLASS
        cut[end] = costs.argmin()
        best[end] = costs[cut[end]]
    classes, end = [], len(values)
    while end:
        classes.append(values[end - 1])
        end = cut[end]
    return np.array(classes[::-1], np.int64)


def quota(members: np.ndarray, scenes: int, batch_scenes: int) -> np.ndarray:
    """[C] scenes of each class in a batch, in proportion to `members` [C], and at least one."""
    return np.maximum(1, np.rint(members * batch_scenes / scenes)).astype(int)


def gather_cropped(windows: Windows, chosen: np.ndarray, slots: int, focus: np.ndarray) -> Scene:
    """The scenes `chosen` [S] as one Scene `[S, slots, ...]`, without what a network does not see.

    Of more than `slots` agents one is kept with its nearest neighbours; `focus` [S] in [0, 1)
    chooses it, as a share of the scene's agents.
    """
    if windows.sizes[chosen].max() > slots:
        windows = _cropped(windows, chosen, slots, focus)
        chosen = np.arange(len(chosen))
    scenes = gather_scenes(windows, chosen, slots)
    return scenes.replace(origin=None, identity=None, extras={})


def _cropped(windows: Windows, chosen: np.ndarray, agents: int, focus: np.ndarray) -> Windows:
    rows = []
    for scene, share in zip(chosen, focus):
        member = np.arange(*windows.bounds[scene : scene + 2])
        if len(member) > agents:
            here = windows.position[member, windows.obs_len - 1]
            focal = int(share * len(member))
            distance = np.linalg.norm(here - here[focal], axis=1)
            distance[focal] = -1.0  # Nearest of all, even where others stand on the same spot.
            member = member[np.sort(np.argpartition(distance, agents - 1)[:agents])]
        rows.append(member)
    kept = np.concatenate(rows)
    return dataclasses.replace(
        windows,
        position=windows.position[kept],
        agent=windows.agent[kept],
        bounds=np.concatenate([[0], np.cumsum([len(member) for member in rows])]),
        identity=windows.identity[chosen],
        extras={},
    )


def merge(parts: Sequence[AnyArray]) -> Array:
    """`[scenes, slots, ...]` of each group as one array `[A, ...]` of all slots."""
    return jnp.concatenate([part.reshape(-1, *part.shape[2:]) for part in parts])


def split(whole: Array, shapes: Sequence[tuple[int, ...]], axis: int = 0) -> list[Array]:
    """Cut an axis of `whole [...]` into parts, each of its own shape."""
    ends = list(itertools.accumulate(math.prod(shape) for shape in shapes))[:-1]
    before, after = whole.shape[:axis], whole.shape[axis + 1 :]
    parts = jnp.split(whole, ends, axis)
    return [part.reshape(*before, *shape, *after) for part, shape in zip(parts, shapes)]
