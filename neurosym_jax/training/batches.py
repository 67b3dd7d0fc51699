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
from neurosym_jax.scene import AnyArray, Scene, moves_of
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
        self._windows = windows
        self._seed = seed
        sizes = windows.sizes
        if max_agents is not None:
            sizes = np.minimum(sizes, max_agents)
        classes = size_classes(sizes, batch_scenes)
        class_of = np.searchsorted(classes, sizes)
        members = [np.flatnonzero(class_of == index) for index in range(len(classes))]
        counts = np.array([len(scenes) for scenes in members])
        quotas = quota(counts, len(sizes), batch_scenes)
        self._classes = list(zip(classes.tolist(), members, quotas.tolist()))

    def steps(self, first: int, count: int) -> Groups:
        """`count` batches from step `first`: a Scene `[count, quota, slots, ...]` of each class."""
        classes = range(len(self._classes))
        return tuple(self._of_class(index, first, count) for index in classes)

    def batch(self, step: int) -> Groups:
        """The batch of one step: a Scene `[quota, slots, ...]` of each class."""
        return jax.tree.map(lambda leaf: leaf[0], self.steps(step, 1))

    def _of_class(self, index: int, first: int, count: int) -> Scene:
        slots, members, quota = self._classes[index]
        place = np.arange(first * quota, (first + count) * quota)
        epoch, within = np.divmod(place, len(members))
        chosen = np.empty(len(place), int)
        for number in np.unique(epoch):
            random = np.random.default_rng([self._seed, index, number])
            order = random.permutation(members)
            now = epoch == number
            chosen[now] = order[within[now]]
        # Drawn step by step: the result does not depend on how many steps a call asks
        # for.
        focus = np.empty((count, quota))
        for row in range(count):
            random = np.random.default_rng([self._seed, index, first + row, 1])
            focus[row] = random.random(quota)
        scenes = gather_cropped(self._windows, chosen, slots, focus.ravel())

        def by_step(array: AnyArray) -> AnyArray:
            return array.reshape(count, quota, *array.shape[1:])

        return jax.tree.map(by_step, scenes)


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
        scenes = quota(members, len(sizes), batch_scenes)
        pairs = scenes * float(values[end - 1]) ** 2
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
    share = members * batch_scenes / scenes
    return np.maximum(1, np.rint(share)).astype(int)


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
            # Nearest of all, even where others stand on the same spot.
            distance[focal] = -1.0
            nearest = np.argpartition(distance, agents - 1)[:agents]
            member = member[np.sort(nearest)]
        rows.append(member)
    member_rows = np.concatenate(rows)
    sizes = [len(member) for member in rows]
    return dataclasses.replace(
        windows,
        position=windows.position[member_rows],
        agent=windows.agent[member_rows],
        bounds=np.append(0, np.cumsum(sizes)),
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
    sizes = [math.prod(shape) for shape in shapes]
    ends = list(itertools.accumulate(sizes))[:-1]
    before = merged.shape[:axis]
    after = merged.shape[axis + 1 :]
    parts = []
    for part, shape in zip(jnp.split(merged, ends, axis), shapes):
        parts.append(part.reshape(*before, *shape, *after))
    return parts


def _move(groups: Groups, key: Array, recipe: Recipe) -> Groups:
    """Rotate and mirror a share of the scenes, each by its own angle; scale all."""
    if not recipe.rotate and not recipe.scale and recipe.stretch == 1:
        return groups
    scenes = _counts(groups)
    choose, turn, flip, stretch = jax.random.split(key, 4)
    total = _total(groups)
    turned = jax.random.uniform(choose, (total,)) < recipe.rotate
    factor = _factors(stretch, total, recipe)
    angle = jax.random.uniform(turn, (total,), maxval=2 * jnp.pi)
    angle = jnp.where(turned, angle, 0.0)
    sign = jax.random.rademacher(flip, (total,), angle.dtype)
    sign = jnp.where(turned, sign, 1.0)
    cos = factor * jnp.cos(angle)
    sin = factor * jnp.sin(angle)
    matrix = jnp.stack([cos, -sin * sign, sin, cos * sign], axis=-1)
    matrix = matrix.reshape(total, 2, 2)

    def move(scene: Scene, matrix: Array) -> Scene:
        def moved(vectors: AnyArray) -> Array:
            return jnp.einsum("sab,sntb->snta", matrix, vectors)

        return scene.replace(
            observed=moved(scene.observed),
            displacement=moved(scene.displacement),
            future=moved(scene.known_future),
        )

    return tuple(map(move, groups, split(matrix, scenes)))


def _factors(key: Array, total: int, recipe: Recipe) -> Array:
    """[total] factors of the lengths in each scene; consumes `key`."""
    if recipe.stretch == 1:
        low, high = 1 - recipe.scale, 1 + recipe.scale
        return jax.random.uniform(key, (total,), minval=low, maxval=high)
    bound = math.log(recipe.stretch)
    power = jax.random.uniform(key, (total,), minval=-bound, maxval=bound)
    return jnp.exp(power)


def _jitter(groups: Groups, key: Array, recipe: Recipe) -> Groups:
    """Add noise to observed positions, of a size drawn for each scene; futures stay as they are."""
    if not recipe.jitter:
        return groups
    size, error = jax.random.split(key)
    scenes = _counts(groups)
    shapes = [scene.observed.shape for scene in groups]
    # One draw for all groups: each draw adds a second of compiling to the step.
    errors = jax.random.normal(error, (sum(map(math.prod, shapes)),))
    per_scene = (_total(groups), 1, 1, 1)
    clean = recipe.clean_share
    if clean:
        level = jax.random.uniform(size, per_scene, minval=-clean / (1 - clean))
        deviations = recipe.jitter * jnp.maximum(level, 0)
    else:
        deviations = jax.random.uniform(size, per_scene, maxval=recipe.jitter)

    def jittered(scene: Scene, errors: Array, deviation: Array) -> Scene:
        observed = scene.observed + deviation * errors
        return scene.replace(observed=observed, displacement=moves_of(observed))

    errors_of = split(errors, shapes)
    deviation_of = split(deviations, scenes)
    return tuple(map(jittered, groups, errors_of, deviation_of))


def _single_agents(groups: Groups, key: Array, recipe: Recipe) -> Groups:
    """Reduce some scenes to one person, because training windows hold two people or more."""
    if not recipe.single_agent_share:
        return groups
    choose, who = jax.random.split(key)
    scenes = _counts(groups)
    shapes = [scene.valid.shape for scene in groups]
    alone = jax.random.uniform(choose, (_total(groups),)) < recipe.single_agent_share
    lots = jax.random.uniform(who, (sum(map(math.prod, shapes)),))

    def reduce(scene: Scene, alone: Array, lots: Array) -> Scene:
        valid = jnp.asarray(scene.valid)
        lot = jnp.where(valid, lots, -1)
        first = lot.argmax(axis=1)
        is_drawn = jnp.arange(valid.shape[1])[None] == first[:, None]
        return scene.replace(valid=valid & (is_drawn | ~alone[:, None]))

    return tuple(map(reduce, groups, split(alone, scenes), split(lots, shapes)))


def _counts(groups: Groups) -> list[tuple[int]]:
    """The number of scenes of each group, as a shape."""
    return [(scene.valid.shape[0],) for scene in groups]


def _total(groups: Groups) -> int:
    """The number of scenes of all groups."""
    return sum(scene.valid.shape[0] for scene in groups)


AUGMENTATIONS = (_move, _jitter, _single_agents)
"""`(groups, key, recipe) -> groups`, applied in this order; each consumes its key."""


def augment(groups: Groups, key: Array, recipe: Recipe) -> Groups:
    """Apply all augmentations that the recipe asks for to a batch; consumes `key`."""
    # The first keys do not depend on how many there are: a new augmentation changes no
    # old recipe.
    keys = jax.random.split(key, len(AUGMENTATIONS))
    for augmentation, part in zip(AUGMENTATIONS, keys):
        groups = augmentation(groups, part, recipe)
    return groups
