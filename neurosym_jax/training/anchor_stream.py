"""Training batches of scenes of one size class, to be merged into crowds."""

import numpy as np

from neurosym_jax.data.batching import gather_scenes
from neurosym_jax.data.windows import Windows
from neurosym_jax.scene import Scene
from neurosym_jax.training.recipe import AnchorRecipe
from neurosym_jax.training.stream import cropped

__all__ = ["CLASSES", "AnchorStream"]

CLASSES = (3, 9, 24)
"""Padded sizes of scenes; larger ones are cropped to a random agent and its nearest neighbours."""


class AnchorStream:
    """Batches of `windows` that depend on the recipe's seed and the step only."""

    def __init__(self, windows: Windows, recipe: AnchorRecipe):
        self._windows, self._recipe = windows, recipe
        sizes = np.minimum(windows.sizes, CLASSES[-1])
        class_of = np.searchsorted(CLASSES, sizes)
        self._classes = [(slots, np.flatnonzero(class_of == i)) for i, slots in enumerate(CLASSES)]
        self._classes = [each for each in self._classes if len(each[1])]
        shares = [len(of) * sizes[of].mean() ** recipe.crowd_tilt for _, of in self._classes]
        self._shares = np.array(shares) / sum(shares)

    def batch(self, step: int) -> tuple[Scene, np.ndarray]:
        """Scenes `[B, slots, ...]`, and the index [B] of the crowd that each is merged into."""
        recipe, rng = self._recipe, np.random.default_rng([self._recipe.seed, step])
        slots, members = self._classes[rng.choice(len(self._classes), p=self._shares)]
        count = max(1, min(recipe.batch_scenes, recipe.batch_people // slots))
        chosen, windows = rng.choice(members, count), self._windows
        if windows.sizes[chosen].max() > slots:
            windows, chosen = cropped(windows, chosen, slots, rng.random(count))
        mean = windows.sizes[chosen].mean()
        merged = 1
        if rng.random() < recipe.crowd_share:
            most = np.log(max(1, recipe.crowd_people / mean))
            merged = round(np.exp(rng.uniform(0, most)))
        scenes = gather_scenes(windows, chosen, slots).replace(origin=None, identity=None)
        return scenes.replace(extras={}), np.arange(count) // merged
