"""Whether windows were among those that a model was trained on, by their shapes.

A model keeps hashes of some of its training windows: the rounded moves of eight steps
that go more than a metre and are not straight. A copy is found whatever its name, ids,
frames or origin are.
"""

import base64
import re

import numpy as np

from neurosym_jax.data.windows import Windows

__all__ = [
    "chance_shapes",
    "fingerprint",
    "is_fingerprint",
    "merged_fingerprints",
    "seen_before",
]
__all__ += ["shared_shapes"]

STEPS = 8  # observed and predicted steps of a shape; models of all horizons share it
CELL = 0.01  # metres to which moves are rounded
OFFSET = 0.337  # of the cells' bounds, so that no position in tenths of millimetres lies on one
KEPT = 512  # hashes that a model keeps: the smallest
BYTES = 6  # of a hash


def fingerprint(windows: Windows) -> str:
    """The smallest `KEPT` hashes of the shapes in `windows`, in base64; at most 4 kB."""
    return _encoded(_hashes(windows))


def merged_fingerprints(*stored: str) -> str:
    """The fingerprint of all windows of several."""
    return _encoded(np.unique(np.concatenate([*map(_decoded, stored)])))


def _encoded(hashes: np.ndarray) -> str:
    data = hashes[:KEPT].astype(">u8").view(np.uint8).reshape(-1, 8)
    return base64.b64encode(data[:, 8 - BYTES :].tobytes()).decode()


def _decoded(stored: str) -> np.ndarray:
    data = np.frombuffer(base64.b64decode(stored), np.uint8).reshape(-1, BYTES)
    return np.pad(data, ((0, 0), (8 - BYTES, 0))).view(">u8").ravel().astype(np.uint64)


def seen_before(stored: str, windows: Windows) -> tuple[int, int]:
    """How many shapes in `windows` are in a fingerprint, and how many were looked for there."""
    stored_hashes, hashes = _decoded(stored), _hashes(windows)
    if len(stored_hashes) == KEPT:
        hashes = hashes[hashes <= stored_hashes.max()]
    return int(np.isin(hashes, stored_hashes).sum()), len(hashes)


def shared_shapes(windows: Windows, others: Windows) -> tuple[int, int]:
    """How many shapes in `windows` are in `others`, and how many there are."""
    hashes = _hashes(windows)
    return int(np.isin(hashes, _hashes(others)).sum()), len(hashes)


def chance_shapes(windows: Windows) -> float:
    """The share of shapes in `windows` that another person of the same recording has too.

    Where positions are rounded coarsely, people who are not the same move alike by
    chance: about this share of other people's shapes is found in `windows`. Copies of a
    whole recording do not raise it.
    """
    hashes, rows = _shapes(windows)
    recording = np.repeat(windows.identity[:, 0], windows.sizes)[rows]
    people = np.unique(
        np.stack([hashes, recording, windows.agent[rows].astype(np.uint64)]), axis=1
    )
    _, others = np.unique(people[:2], axis=1, return_counts=True)
    return float(others[others > 1].sum() / max(others.sum(), 1))


def is_fingerprint(value: object) -> bool:
    """Whether a value read from a file is what `fingerprint` returns."""
    pattern = rf"([A-Za-z0-9+/]{{8}}){{0,{KEPT}}}"
    return isinstance(value, str) and re.fullmatch(pattern, value) is not None


def _hashes(windows: Windows) -> np.ndarray:
    """[H] uint64 below 2^48, ascending: one for each shape that tells something."""
    return np.unique(_shapes(windows)[0])


def _shapes(windows: Windows) -> tuple[np.ndarray, np.ndarray]:
    """[R] uint64 below 2^48, and [R] their agent windows: of shapes that tell something."""
    moves = np.diff(windows.position[:, :STEPS], axis=1)
    cells = np.floor(moves / CELL + OFFSET).astype(np.int64)
    far = np.linalg.norm(moves, axis=-1).sum(axis=1) > 1.0
    # Straight ways at one pace, as annotators draw them, are alike in many recordings.
    turns = np.sum(np.any(np.diff(cells, axis=1) != 0, axis=-1), axis=1)
    rows = np.flatnonzero(far & (turns >= STEPS - 3))
    chosen = cells[rows].reshape(len(rows), cells.shape[1] * 2).astype(np.uint64)
    factors = (
        np.random.default_rng(0).integers(1, 2**63, chosen.shape[1], np.uint64) * 2 + 1
    )
    mixed = (chosen * factors).sum(axis=1, dtype=np.uint64)
    for shift, factor in (
        (30, 0xBF58476D1CE4E5B9),
        (27, 0x94D049BB133111EB),
    ):  # splitmix64
        mixed = (mixed ^ (mixed >> np.uint64(shift))) * np.uint64(factor)
    return mixed >> np.uint64(16), rows
