"""An endless stream of training batches that depends on (seed, step) only.

A batch has a fixed number of scenes of every size class, in proportion to the data (stratified by
size), so that one compiled step serves all batches. Within a class every scene comes once before
any comes again.
"""

import dataclasses

import jax
import numpy as np

from neurosym_jax.data.batching import gather_scenes
from neurosym_jax.data.windows import Windows
from neurosym_jax.scene import Scene
from neurosym_jax.training.size_classes import quota, size_classes

__all__ = ["SceneStream", "cropped"]


class SceneStream:
    """Batches of about `batch_scenes` scenes of `windows`.

    Scenes of more than `max_agents` agents are cropped to a random agent and its nearest
    neighbours.
    """

    def __init__(
        self, windows: Windows, batch_scenes: int, seed: int, max_agents: int | None = None
    ):
        self.windows, self.seed, self.max_agents = windows, seed, max_agents
        sizes = windows.sizes if max_agents is None else np.minimum(windows.sizes, max_agents)
        classes = size_classes(sizes, batch_scenes)
        class_of = np.searchsorted(classes, sizes)
        self._slots = classes.tolist()
        self._members = [np.flatnonzero(class_of == index) for index in range(len(classes))]
        counts = np.array([len(members) for members in self._members])
        self._quotas = quota(counts, len(sizes), batch_scenes).tolist()

    @property
    def shapes(self) -> list[tuple[int, int]]:
        """(scenes in a batch, slots of each) for every size class."""
        return list(zip(self._quotas, self._slots))

    def steps(self, first: int, count: int) -> tuple[Scene, ...]:
        """`count` batches from step `first`: a Scene `[count, quota, slots, ...]` of each class."""
        return tuple(self._of_class(index, first, count) for index in range(len(self._slots)))

    def _of_class(self, index: int, first: int, count: int) -> Scene:
        members, quota, slots = self._members[index], self._quotas[index], self._slots[index]
        place = np.arange(first * quota, (first + count) * quota)
        epoch, within = np.divmod(place, len(members))
        chosen = np.empty(len(place), int)
        for number in np.unique(epoch):
            order = np.random.default_rng([self.seed, index, number]).permutation(members)
            chosen[epoch == number] = order[within[epoch == number]]
        windows = self.windows
        if self.max_agents is not None and windows.sizes[chosen].max() > self.max_agents:
            # Drawn step by step: the result does not depend on how many steps a call asks for.
            focus = np.concatenate(
                [
                    np.random.default_rng([self.seed, index, step, 1]).random(quota)
                    for step in range(first, first + count)
                ]
            )
            windows, chosen = cropped(windows, chosen, self.max_agents, focus)
        scenes = gather_scenes(windows, chosen, slots).replace(origin=None, identity=None)
        return jax.tree.map(lambda array: array.reshape(count, quota, *array.shape[1:]), scenes)


def cropped(
    windows: Windows, chosen: np.ndarray, agents: int, focus: np.ndarray
) -> tuple[Windows, np.ndarray]:
    """The chosen scenes as new windows, those of more than `agents` cropped around one agent.

    `focus` [S] in [0, 1) chooses the agent of each scene, as a share of its agents.
    """
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
    bounds = np.concatenate([[0], np.cumsum([len(member) for member in rows])])
    cropped = dataclasses.replace(
        windows,
        position=windows.position[kept],
        agent=windows.agent[kept],
        bounds=bounds,
        identity=windows.identity[chosen],
    )
    return cropped, np.arange(len(chosen))
