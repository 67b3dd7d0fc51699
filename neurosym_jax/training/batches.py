"""Batches of scenes in the order of a seed, cropped, merged and augmented."""

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
from neurosym_jax.training.recipe import Recipe

__all__ = [
    "AUGMENTATIONS",
    "Groups",
    "SceneStream",
    "augment",
    "gather_cropped",
    "merge",
    "size_classes",
    "split",
]

Groups = tuple[Scene, ...]
"""A batch: one Scene `[scenes, slots, ...]` for each size class, computed on together."""

COST_OF_A_CLASS = 1000
"""Pairs that another class must save: each class is compiled and looped over separately."""


class SceneStream:
    """Batches of about `batch_scenes` scenes of `windows`.

    Scenes of more than `max_agents` agents are cropped to a random agent and its
    nearest neighbours.
    """

    def __init__(
        self,
        windows: Windows,
        batch_scenes: int,
        seed: int,
        max_agents: int | None = None,
    ):
        self._windows, self._seed = windows, seed
        sizes = (
            windows.sizes
            if max_agents is None
            else np.minimum(windows.sizes, max_agents)
        )
        classes = size_classes(sizes, batch_scenes)
        class_of = np.searchsorted(classes, sizes)
        members = [np.flatnonzero(class_of == index) for index in range(len(classes))]
        quotas = quota(np.array([*map(len, members)]), len(sizes), batch_scenes)
        self._classes = list(zip(classes.tolist(), members, quotas.tolist()))

    def steps(self, first: int, count: int) -> Groups:
        """`count` batches from step `first`: a Scene `[count, quota, slots, ...]` of each class."""
        return tuple(
            self._of_class(index, first, count) for index in range(len(self._classes))
        )

    def batch(self, step: int) -> Groups:
        """The batch of one step: a Scene `[quota, slots, ...]` of each class."""
        return jax.tree.map(lambda leaf: leaf[0], self.steps(step, 1))

    def _of_class(self, index: int, first: int, count: int) -> Scene:
        (slots, members, quota), seed = self._classes[index], self._seed
        place = np.arange(first * quota, (first + count) * quota)
        epoch, within = np.divmod(place, len(members))
        chosen = np.empty(len(place), int)
        for number in np.unique(epoch):
            order = np.random.default_rng([seed, index, number]).permutation(members)
            chosen[epoch == number] = order[within[epoch == number]]
        # Drawn step by step: the result does not depend on how many steps a call asks
        # for.
        focus = [
            np.random.default_rng([seed, index, step, 1]).random(quota)
            for step in range(first, first + count)
        ]
        scenes = gather_cropped(self._windows, chosen, slots, np.concatenate(focus))
        return jax.tree.map(
            lambda array: array.reshape(count, quota, *array.shape[1:]), scenes
        )


def size_classes(sizes: np.ndarray, batch_scenes: int) -> np.ndarray:
    """[C] padded sizes for scenes of `sizes` [S], ascending; a scene takes the smallest that fits.

    A batch has a `quota` of every class, and pooling costs the square of each padded
    size. The classes minimise the sum of costs (dynamic programming over the sizes).
    """
    values, counts = np.unique(sizes, return_counts=True)
    below = np.concatenate([[0], np.cumsum(counts)])
    best = np.zeros(len(values) + 1)
    cut = np.zeros(len(values) + 1, int)
    for end in range(1, len(values) + 1):
        # One class from each possible beginning to `end`, after the best classes before
        # it.
        members = below[end] - below[:end]
        pairs = quota(members, len(sizes), batch_scenes) * float(values[end - 1]) ** 2
        costs = best[:end] + pairs + COST_OF_A_CLASS
        cut[end] = costs.argmin()
        best[end] = costs[cut[end]]
    classes = []
    end = len(values)
    while end:
        classes.append(values[end - 1])
        end = cut[end]
    return np.array(classes[::-1], np.int64)


def quota(members: np.ndarray, scenes: int, batch_scenes: int) -> np.ndarray:
    """[C] scenes of each class in a batch, in proportion to `members` [C], and at least one."""
    return np.maximum(1, np.rint(members * batch_scenes / scenes)).astype(int)


def gather_cropped(
    windows: Windows, chosen: np.ndarray, slots: int, focus: np.ndarray
) -> Scene:
    """The scenes `chosen` [S] as one Scene `[S, slots, ...]`, without what a network does not see.

    Of more than `slots` agents one is kept with its nearest neighbours; `focus` [S] in
    [0, 1) chooses it, as a share of the scene's agents.
    """
    if windows.sizes[chosen].max() > slots:
        windows = _cropped(windows, chosen, slots, focus)
        chosen = np.arange(len(chosen))
    scenes = gather_scenes(windows, chosen, slots)
    return scenes.replace(origin=None, identity=None, extras={})


def _cropped(
    windows: Windows, chosen: np.ndarray, agents: int, focus: np.ndarray
) -> Windows:
    rows = []
    for scene, share in zip(chosen, focus):
        member = np.arange(*windows.bounds[scene : scene + 2])
        if len(member) > agents:
            position = windows.position[member, windows.obs_len - 1]
            focal = int(share * len(member))
            distance = np.linalg.norm(position - position[focal], axis=1)
            distance[
                focal
            ] = -1.0  # Nearest of all, even where others stand on the same spot.
            member = member[np.sort(np.argpartition(distance, agents - 1)[:agents])]
        rows.append(member)
    member_rows = np.concatenate(rows)
    return dataclasses.replace(
        windows,
        position=windows.position[member_rows],
        agent=windows.agent[member_rows],
        bounds=np.concatenate([[0], np.cumsum([len(member) for member in rows])]),
        identity=windows.identity[chosen],
        extras={},
    )


def merge(parts: Sequence[AnyArray]) -> Array:
    """`[scenes, slots, ...]` of each group as one array `[A, ...]` of all slots."""
    return jnp.concatenate([part.reshape(-1, *part.shape[2:]) for part in parts])


def split(
    merged: Array, shapes: Sequence[tuple[int, ...]], axis: int = 0
) -> list[Array]:
    """Cut an axis of `whole [...]` into parts, each of its own shape."""
    ends = list(itertools.accumulate(math.prod(shape) for shape in shapes))[:-1]
    before = merged.shape[:axis]
    after = merged.shape[axis + 1 :]
    parts = jnp.split(merged, ends, axis)
    return [part.reshape(*before, *shape, *after) for part, shape in zip(parts, shapes)]


def _move(groups: Groups, key: Array, recipe: Recipe) -> Groups:
    """Rotate and mirror a share of the scenes, each by its own angle; scale all."""
    if not recipe.rotate and not recipe.scale and recipe.stretch == 1:
        return groups
    scenes = _counts(groups)
    choose, turn, flip, stretch = jax.random.split(key, 4)
    total = (sum(count for (count,) in scenes),)
    turned = jax.random.uniform(choose, total) < recipe.rotate
    if recipe.stretch > 1:
        bound = math.log(recipe.stretch)
        factor = jnp.exp(
            jax.random.uniform(stretch, total, minval=-bound, maxval=bound)
        )
    else:
        scale = recipe.scale
        factor = jax.random.uniform(stretch, total, minval=1 - scale, maxval=1 + scale)
    angle = jnp.where(turned, jax.random.uniform(turn, total, maxval=2 * jnp.pi), 0.0)
    sign = jnp.where(turned, jax.random.rademacher(flip, total, angle.dtype), 1.0)
    cos = factor * jnp.cos(angle)
    sin = factor * jnp.sin(angle)
    matrix = jnp.stack([cos, -sin * sign, sin, cos * sign], axis=-1).reshape(
        *total, 2, 2
    )

    def moved(vectors: AnyArray, matrix: Array) -> Array:
        return jnp.einsum("sab,sntb->snta", matrix, vectors)

    return tuple(
        scene.replace(
            observed=moved(scene.observed, part),
            displacement=moved(scene.displacement, part),
            future=moved(scene.known_future, part),
        )
        for scene, part in zip(groups, split(matrix, scenes))
    )


def _jitter(groups: Groups, key: Array, recipe: Recipe) -> Groups:
    """Add noise to observed positions, of a size drawn for each scene; futures stay as they are."""
    if not recipe.jitter:
        return groups
    size, error = jax.random.split(key)
    scenes = _counts(groups)
    shapes = [scene.observed.shape for scene in groups]
    # One draw for all groups: each draw adds a second of compiling to the step.
    errors = jax.random.normal(error, (sum(map(math.prod, shapes)),))
    per_scene = (sum(count for (count,) in scenes), 1, 1, 1)
    clean = recipe.clean_share
    if clean:
        level = jax.random.uniform(size, per_scene, minval=-clean / (1 - clean))
        deviations = recipe.jitter * jnp.maximum(level, 0)
    else:
        deviations = jax.random.uniform(size, per_scene, maxval=recipe.jitter)

    def jittered(scene: Scene, errors: Array, deviation: Array) -> Scene:
        observed = scene.observed + deviation * errors
        first = jnp.zeros_like(observed[..., :1, :])
        displacement = jnp.concatenate([first, jnp.diff(observed, axis=-2)], axis=-2)
        return scene.replace(observed=observed, displacement=displacement)

    return tuple(
        map(jittered, groups, split(errors, shapes), split(deviations, scenes))
    )


def _single_agents(groups: Groups, key: Array, recipe: Recipe) -> Groups:
    """Reduce some scenes to one person, because training windows hold two people or more."""
    if not recipe.single_agent_share:
        return groups
    choose, who = jax.random.split(key)
    scenes = _counts(groups)
    shapes = [scene.valid.shape for scene in groups]
    total = (sum(count for (count,) in scenes),)
    alone = jax.random.uniform(choose, total) < recipe.single_agent_share
    lots = jax.random.uniform(who, (sum(map(math.prod, shapes)),))

    def left(scene: Scene, alone: Array, lots: Array) -> Scene:
        valid = jnp.asarray(scene.valid)
        lot = jnp.where(valid, lots, -1)
        drawn = jnp.arange(valid.shape[1])[None] == lot.argmax(axis=1)[:, None]
        return scene.replace(valid=valid & (drawn | ~alone[:, None]))

    return tuple(map(left, groups, split(alone, scenes), split(lots, shapes)))


def _counts(groups: Groups) -> list[tuple[int]]:
    return [(scene.valid.shape[0],) for scene in groups]


AUGMENTATIONS = (_move, _jitter, _single_agents)
"""`(groups, key, recipe) -> groups`, applied in this order; each consumes its key."""


def augment(groups: Groups, key: Array, recipe: Recipe) -> Groups:
    """Apply all augmentations that the recipe asks for to a batch; consumes `key`."""
    # The first keys do not depend on how many there are: a new augmentation changes no
    # old recipe.
    for augmentation, part in zip(
        AUGMENTATIONS, jax.random.split(key, len(AUGMENTATIONS))
    ):
        groups = augmentation(groups, part, recipe)
    return groups
