"""Windows to padded batches of scenes: a few static shapes, so that compilation stays cheap.

Scenes are sorted into buckets by number of agents. A batch holds scenes of one bucket, about
`slots` agent slots altogether, with a leading scene axis on every array of `Scene`. The last batch
of a bucket is filled up with empty scenes (no valid agent).
"""

import dataclasses

import jax
import numpy as np

from neurosym_jax.data.windows import Windows
from neurosym_jax.scene import Scene, displacements, model_dtype

__all__ = ["BUCKETS", "SLOTS", "Batch", "bucket_of", "make_batches", "single_scene"]

BUCKETS = (4, 8, 16, 32, 64)
"""Agents per padded scene; beyond the last, powers of two."""

SLOTS = 256
"""Agent slots of a batch: with 20 samples the decoder then works in the second-level cache."""


@dataclasses.dataclass(frozen=True, eq=False)
class Batch:
    """Padded scenes of one bucket."""

    scene: Scene
    """Arrays with a leading axis of B scenes and N = bucket agent slots."""
    index: np.ndarray
    """[B] int64 which of the windows' scenes each is; -1 for an empty scene."""


def bucket_of(agents: np.ndarray | int) -> np.ndarray:
    """The bucket (padded size) of scenes with `agents` agents, elementwise."""
    agents = np.asarray(agents)
    small = np.array(BUCKETS)[np.searchsorted(BUCKETS, np.minimum(agents, BUCKETS[-1]))]
    large = 2 ** np.ceil(np.log2(np.maximum(agents, 1))).astype(int)
    return np.where(agents <= BUCKETS[-1], small, large)


def make_batches(windows: Windows, slots: int = SLOTS) -> list[Batch]:
    """All scenes of `windows`, each in exactly one batch.

    Args:
        windows: A agent windows in S scenes.
        slots: agent slots in a batch; a scene larger than this is a batch of its own.
    """
    buckets = bucket_of(windows.sizes)
    return [
        batch
        for bucket in np.unique(buckets)
        for batch in _bucket_batches(windows, np.flatnonzero(buckets == bucket), bucket, slots)
    ]


def single_scene(windows: Windows, index: int) -> Scene:
    """Scene `index` of `windows` alone, padded to its bucket, exactly as in its batch."""
    window = slice(*windows.bounds[index : index + 2])
    position = windows.position[window]
    alone = Windows(
        position=position,
        agent=windows.agent[window],
        bounds=np.array([0, len(position)]),
        identity=windows.identity[index : index + 1],
        obs_len=windows.obs_len,
    )
    (batch,) = make_batches(alone, slots=1)
    return jax.tree.map(lambda array: array[0], batch.scene)


def _bucket_batches(windows: Windows, chosen: np.ndarray, bucket: int, slots: int) -> list[Batch]:
    per_batch = max(1, slots // bucket)
    count = -(-len(chosen) // per_batch) * per_batch
    sizes = windows.sizes[chosen]
    scene = np.repeat(np.arange(len(chosen)), sizes)
    slot = np.arange(sizes.sum()) - np.repeat(np.cumsum(sizes) - sizes, sizes)
    source = np.repeat(windows.bounds[chosen], sizes) + slot

    position = windows.position[source]
    origin = _origins(position[:, windows.obs_len - 1], sizes)
    step = displacements(position[:, : windows.obs_len])
    position = position - origin[scene, None]

    def padded(rows: np.ndarray) -> np.ndarray:
        out = np.zeros((count, bucket, *rows.shape[1:]), model_dtype())
        out[scene, slot] = rows
        return out

    observed = padded(position[:, : windows.obs_len])
    future = padded(position[:, windows.obs_len :])
    displacement = padded(step)
    valid = np.zeros((count, bucket), bool)
    valid[scene, slot] = True
    index = np.full(count, -1)
    index[: len(chosen)] = chosen
    identity = np.zeros((count, 2), np.uint32)
    identity[: len(chosen)] = windows.identity[chosen]
    origins = np.zeros((count, 2))
    origins[: len(chosen)] = origin

    return [
        Batch(
            Scene(
                observed=observed[part],
                displacement=displacement[part],
                valid=valid[part],
                identity=identity[part],
                origin=origins[part],
                future=future[part],
            ),
            index[part],
        )
        for part in (slice(at, at + per_batch) for at in range(0, count, per_batch))
    ]


def _origins(last: np.ndarray, sizes: np.ndarray) -> np.ndarray:
    """[S, 2] centres of the scenes' last observed positions `last [A, 2]`, as `make_scene`'s."""
    first = np.cumsum(sizes) - sizes
    return (np.minimum.reduceat(last, first) + np.maximum.reduceat(last, first)) / 2
