"""What a model recalls of the past of a test place, scene by scene in the order of time.

This protocol sees what happened at the test place before each scene. Its errors are not
those of other protocols, and stand in rows of their own.
"""

import zlib
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from neurosym_jax.data.tracks import Tracks
from neurosym_jax.data.windows import Batch, Windows, bucket_of
from neurosym_jax.errors import InputError, option
from neurosym_jax.models.forecast import Model
from neurosym_jax.models.place.mixture import Remembered
from neurosym_jax.models.place.place import Place, load_place, steps_of
from neurosym_jax.scene import make_scene

__all__ = ["recall_batches", "watch_windows"]


def recall_batches(
    model: Model,
    windows: Windows,
    batches: Sequence[Batch],
    recordings: Sequence[Tracks],
    file: Path | None = None,
) -> list[Remembered]:
    """What is recalled for each batch of B scenes: [B, U, N, T, 2] and [B, U, N].

    Arguments are those of `watch_windows`; `batches` are of the same windows.
    """
    scenes = watch_windows(model, windows, recordings, file)
    return [_padded(batch, scenes) for batch in batches]


def watch_windows(
    model: Model,
    windows: Windows,
    recordings: Sequence[Tracks],
    file: Path | None = None,
) -> list[Remembered]:
    """What is recalled for each scene of `windows`, `future [U, N, T, 2]` from its origin.

    Each recording is a place of its own, watched from its beginning. Of what a scene's
    last observed step shows, and of all before it, its forecast knows; nothing else.

    Args:
        model: whose forecasts the memory joins.
        windows: cut from the recordings.
        recordings: on one grid.
        file: of a place, see `Place.save`, with which each recording begins.

    Raises:
        InputError: without recordings, whose times the order follows.
    """
    if not recordings:
        name = option("online")
        raise InputError(f"{name}: needs recordings, of which the time is known")
    recalled: list[Remembered | None] = [None] * windows.scenes
    digests = windows.identity[:, 0]
    for tracks in recordings:
        own = np.flatnonzero(digests == zlib.crc32(tracks.recording.encode()))
        last = windows.identity[own, 1].astype(int) + windows.obs_len - 1
        scene_at = dict(zip(last.tolist(), own.tolist()))
        place = Place(model) if file is None else load_place(file, model)
        # Nobody looks at what comes after the last scene.
        steps = steps_of(tracks, windows.period)[: max(scene_at, default=-1) + 1]
        for index, step in enumerate(steps):
            place.watch_step(step)
            if index in scene_at:
                number = scene_at[index]
                recalled[number] = _recall(place, windows, number)
    return [scene for scene in recalled if scene is not None]


def _recall(place: Place, windows: Windows, number: int) -> Remembered:
    """What is recalled now for one scene, without padding."""
    rows = slice(*windows.bounds[number : number + 2])
    observed = windows.position[rows, : windows.obs_len]
    scene = make_scene(observed)
    slots = int(bucket_of(len(observed)))
    recalled = place.recalled(observed, scene, slots)
    people = len(observed)
    return Remembered(*(np.asarray(part)[:, :people] for part in recalled))


def _padded(batch: Batch, scenes: Sequence[Remembered]) -> Remembered:
    """The scenes of a batch, with zeros for slots and scenes without anybody."""
    count, slots = batch.scene.valid.shape
    fields = []
    for parts in zip(*scenes):
        points, _, *rest = parts[0].shape
        field = np.zeros((count, points, slots, *rest), parts[0].dtype)
        for row, number in enumerate(batch.index.tolist()):
            if number >= 0:
                people = parts[number].shape[1]
                field[row, :, :people] = parts[number]
        fields.append(field)
    return Remembered(*fields)
