"""Where people will be, as a costmap: the probability that a cell is taken.

At one moment a person takes a cell with the share of the futures that bring them within
`RADIUS` of it; somebody takes it unless nobody does. Of all moments the worst counts,
and later ones for less, as who comes later may still be let by.
"""

import numpy as np

CELL = 0.1
"""Metres."""
RADIUS = 0.4
"""Metres, of a person and of what a robot should keep from them."""
FADE = 4.0
"""Seconds after which a place counts for 1/e."""
WIDEST = 40.0
"""Metres along a side; people beyond are left out."""

REACH = int(RADIUS / CELL)
OFFSETS = np.mgrid[-REACH : REACH + 1, -REACH : REACH + 1].reshape(2, -1)
DISC = OFFSETS[:, np.hypot(*OFFSETS) * CELL <= RADIUS]
"""[2, D] cells of a person around the one in which they are."""


class Costmap:
    """Costmaps of a stream; each also covers the one before, so that old cells are cleared."""

    def __init__(self, ahead: float | None = None):
        """Of the moment `ahead` seconds from now alone; by default of all moments."""
        self._ahead = ahead
        self._former = np.zeros((0, 2), int)  # first and last cell of the one before

    def update(
        self, futures: np.ndarray, weights: np.ndarray, period: float
    ) -> tuple[np.ndarray, np.ndarray]:
        """Per cent [rows, columns] that a cell is taken, and its corner [2] in metres.

        `futures [K, N, T, 2]` are positions in metres, T = 0 now, every `period`
        seconds; `weights [K]` sum to one.
        """
        cells = _cells(futures)
        corners = cells.reshape(-1, 2)
        own = np.zeros((0, 2), int)
        if len(corners):
            own = np.array([corners.min(axis=0) - REACH, corners.max(axis=0) + REACH])
        covered = np.concatenate([own, self._former])
        self._former = own
        if not len(covered):
            covered = np.zeros((1, 2), int)
        first, last = covered.min(axis=0), covered.max(axis=0)
        columns, rows = last - first + 1
        worst = np.zeros((rows, columns))
        steps = futures.shape[2]
        if self._ahead is not None:
            step = min(round(self._ahead / period), steps - 1)
            worst = _taken(cells[:, :, step] - first, weights, (rows, columns))
            steps = 0
        for step in range(steps):
            taken = _taken(cells[:, :, step] - first, weights, (rows, columns))
            worst = np.maximum(worst, taken * np.exp(-step * period / FADE))
        return np.rint(100 * worst).astype(np.int8), first * CELL


def _cells(futures: np.ndarray) -> np.ndarray:
    """[K, M, T, 2] columns and rows of the positions of the M people who are near."""
    now = futures[0, :, 0]
    middle = np.median(now, axis=0) if len(now) else np.zeros(2)
    low, high = middle - WIDEST / 2, middle + WIDEST / 2
    near = ((now > low) & (now < high)).all(axis=1)
    return np.floor(np.clip(futures[:, near], low, high) / CELL).astype(int)


def _taken(
    cells: np.ndarray, weights: np.ndarray, shape: tuple[int, int]
) -> np.ndarray:
    """[rows, columns] probability that somebody takes a cell, of `cells [K, N, 2]`."""
    people = cells.shape[1]
    free = np.zeros(shape)
    if not people:
        return free
    # Each person has a small grid around all their futures, all of one size.
    first = cells.min(axis=0) - REACH
    width, height = (cells.max(axis=0) + REACH - first).max(axis=0) + 1
    local = (cells - first)[..., None] + DISC
    column, row = local[:, :, 0], local[:, :, 1]
    person = np.arange(people)[:, None]
    index = (person * height + row) * width + column
    shares = np.broadcast_to(weights[:, None, None], index.shape)
    share = np.bincount(index.ravel(), shares.ravel(), people * height * width)
    share = share.reshape(people, height, width)
    # The logarithms of the probabilities that a cell is free are summed over people.
    logarithm = np.log(np.maximum(1 - share, 1e-9))
    for (x, y), part in zip(first.tolist(), logarithm):
        rows, columns = free[y : y + height, x : x + width].shape
        free[y : y + height, x : x + width] += part[:rows, :columns]
    return 1 - np.exp(free)
