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
from neurosym_jax.runtime.programs import full_precision
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
        self._classes = []
        for index, slots in enumerate(classes.tolist()):
            members = np.flatnonzero(class_of == index)
            share = quota(np.array(len(members)), len(sizes), batch_scenes)
            self._classes.append((slots, members, int(share)))

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
    total = sum(count for (count,) in scenes)
    choose, turn, flip, stretch = jax.random.split(key, 4)
    lot = jax.random.uniform(choose, (total,))
    turned = lot < recipe.rotate
    factor = _factors(stretch, total, recipe)
    angle = jax.random.uniform(turn, (total,), maxval=2 * jnp.pi)
    angle = jnp.where(turned, angle, 0.0)
    sign = jax.random.rademacher(flip, (total,), angle.dtype)
    sign = jnp.where(turned, sign, 1.0)
    cos = factor * jnp.cos(angle)
    sin = factor * jnp.sin(angle)
    matrix = jnp.stack([cos, -sin * sign, sin, cos * sign], axis=-1)
    matrix = matrix.reshape(total, 2, 2)

    moved = []
    for scene, matrices in zip(groups, split(matrix, scenes)):
        fields = {}
        for name in ("observed", "displacement", "future"):
            vectors = getattr(scene, name)
            fields[name] = jnp.einsum("sab,sntb->snta", matrices, vectors)
        moved.append(scene.replace(**fields))
    return tuple(moved)


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
    coordinates = sum(map(math.prod, shapes))
    errors = jax.random.normal(error, (coordinates,))
    per_scene = (sum(count for (count,) in scenes), 1, 1, 1)
    clean = recipe.clean_share
    if clean:
        level = jax.random.uniform(size, per_scene, minval=-clean / (1 - clean))
        deviations = recipe.jitter * jnp.maximum(level, 0)
    else:
        deviations = jax.random.uniform(size, per_scene, maxval=recipe.jitter)

    jittered = []
    parts = zip(groups, split(errors, shapes), split(deviations, scenes))
    for scene, scene_errors, deviation in parts:
        observed = scene.observed + deviation * scene_errors
        moves = moves_of(observed)
        jittered.append(scene.replace(observed=observed, displacement=moves))
    return tuple(jittered)


def _single_agents(groups: Groups, key: Array, recipe: Recipe) -> Groups:
    """Reduce some scenes to one person, because training windows hold two people or more."""
    if not recipe.single_agent_share:
        return groups
    choose, who = jax.random.split(key)
    scenes = _counts(groups)
    shapes = [scene.valid.shape for scene in groups]
    total = sum(count for (count,) in scenes)
    alone = jax.random.uniform(choose, (total,)) < recipe.single_agent_share
    slots = sum(map(math.prod, shapes))
    lots = jax.random.uniform(who, (slots,))

    reduced = []
    parts = zip(groups, split(alone, scenes), split(lots, shapes))
    for scene, is_alone, lot in parts:
        valid = jnp.asarray(scene.valid)
        lot = jnp.where(valid, lot, -1)
        drawn = lot.argmax(axis=1)
        is_drawn = jnp.arange(valid.shape[1])[None] == drawn[:, None]
        kept = is_drawn | ~is_alone[:, None]
        reduced.append(scene.replace(valid=valid & kept))
    return tuple(reduced)


def _counts(groups: Groups) -> list[tuple[int]]:
    """The number of scenes of each group, as a shape."""
    return [(scene.valid.shape[0],) for scene in groups]


AUGMENTATIONS = (_move, _jitter, _single_agents)
"""`(groups, key, recipe) -> groups`, applied in this order; each consumes its key."""


@full_precision
def augment(groups: Groups, key: Array, recipe: Recipe) -> Groups:
    """Apply all augmentations that the recipe asks for to a batch; consumes `key`."""
    # The first keys do not depend on how many there are: a new augmentation changes no
    # old recipe.
    keys = jax.random.split(key, len(AUGMENTATIONS))
    for augmentation, part in zip(AUGMENTATIONS, keys):
        groups = augmentation(groups, part, recipe)
    return groups
