"""Padded batches of scenes in a few static shapes, so that compilation stays cheap."""

import dataclasses

import jax
import numpy as np

from neurosym_jax.data.windows import Windows
from neurosym_jax.scene import Scene, displacements, model_dtype, relative_positions

__all__ = ["Batch", "bucket_of", "gather_scenes", "make_batches", "single_scene"]


@dataclasses.dataclass(frozen=True, eq=False)
class Batch:
    """Padded scenes of one bucket of sizes, filled up with empty scenes (no valid agent)."""

    scene: Scene  # arrays with a leading axis of B scenes and N = bucket agent slots
    index: np.ndarray  # [B] int64 index of each scene in the windows; -1 for an empty scene


def bucket_of(agents: np.ndarray | int) -> np.ndarray:
    """Padded size of scenes with `agents` [...] agents: a power of two, at least 4; for more than
    1,024 a multiple of these."""
    power = 2 ** np.ceil(np.log2(np.clip(agents, 4, 1024))).astype(int)
    return np.where(np.asarray(agents) > 1024, -(-np.asarray(agents) // 1024) * 1024, power)


def make_batches(windows: Windows, slots: int = 1024) -> list[Batch]:
    """All scenes of `windows`, each in exactly one batch of about `slots` agent slots."""
    buckets = bucket_of(windows.sizes)
    batches = []
    for bucket in np.unique(buckets):
        chosen = np.flatnonzero(buckets == bucket)
        size = max(1, slots // bucket)
        for at in range(0, len(chosen), size):
            part = chosen[at : at + size]
            index = np.pad(part, (0, size - len(part)), constant_values=-1)
            batches.append(Batch(gather_scenes(windows, part, int(bucket), size), index))
    return batches


def single_scene(windows: Windows, index: int) -> Scene:
    """Scene `index` of `windows`, padded to its bucket, with the same numbers as in its batch."""
    slots = int(bucket_of(windows.sizes[index]))
    return jax.tree.map(lambda array: array[0], gather_scenes(windows, np.array([index]), slots))


def gather_scenes(
    windows: Windows, chosen: np.ndarray, slots: int, count: int | None = None
) -> Scene:
    """The scenes `chosen` ([S] indices, repeats allowed), each padded to `slots` agent slots, and
    empty scenes up to `count`, as one Scene with a leading axis."""
    count = len(chosen) if count is None else count
    sizes = windows.sizes[chosen]
    scene = np.repeat(np.arange(len(chosen)), sizes)
    rows = windows.rows(chosen)
    slot = rows - windows.bounds[chosen][scene]
    position = windows.position[rows]
    last = position[:, windows.obs_len - 1]
    origin = np.zeros((count, 2))
    first = np.cumsum(sizes) - sizes
    low, high = np.minimum.reduceat(last, first), np.maximum.reduceat(last, first)
    origin[: len(chosen)] = (low + high) / 2  # As `make_scene`.
    step = displacements(position[:, : windows.obs_len])
    position = relative_positions(position, origin[scene, None])

    def padded(values: np.ndarray, dtype: np.dtype | None = None) -> np.ndarray:
        out = np.zeros((count, slots, *values.shape[1:]), dtype or values.dtype)
        out[scene, slot] = values
        return out

    identity = np.zeros((count, 2), np.uint32)
    identity[: len(chosen)] = windows.identity[chosen]
    return Scene(
        observed=padded(position[:, : windows.obs_len], model_dtype()),
        displacement=padded(step, model_dtype()),
        valid=padded(np.ones(len(rows), bool)),
        identity=identity,
        origin=origin,
        future=padded(position[:, windows.obs_len :], model_dtype()),
        extras={name: padded(of[rows]) for name, of in windows.extras.items()},
    )
