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
NO_CELLS = np.zeros((0, 2), int)


class Costmap:
    """Costmaps of a stream; each also covers the one before, so that old cells are cleared."""

    def __init__(self, ahead: float | None = None):
        """Of the moment `ahead` seconds from now alone; by default of all moments."""
        self._ahead = ahead
        self._former = NO_CELLS  # first and last cell of the one before

    def update(
        self, futures: np.ndarray, weights: np.ndarray, period: float
    ) -> tuple[np.ndarray, np.ndarray]:
        """Per cent [rows, columns] that a cell is taken, and its corner [2] in metres.

        `futures [K, N, T, 2]` are positions in metres, T = 0 now, every `period`
        seconds; `weights [K]` sum to one.
        """
        cells = _cells(futures)
        first, last = self._cover(cells.reshape(-1, 2))
        columns, rows = last - first + 1
        cells = cells - first
        steps = cells.shape[2]
        if self._ahead is not None:
            step = min(round(self._ahead / period), steps - 1)
            worst = _taken(cells[:, :, step], weights, (rows, columns))
        else:
            worst = np.zeros((rows, columns))
            for step in range(steps):
                taken = _taken(cells[:, :, step], weights, (rows, columns))
                faded = taken * np.exp(-step * period / FADE)
                worst = np.maximum(worst, faded)
        per_cent = np.rint(100 * worst)
        return per_cent.astype(np.int8), first * CELL

    def _cover(self, cells: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """First and last cell [2] of the people in `cells [C, 2]` and of the costmap before."""
        own = NO_CELLS
        if len(cells):
            first = cells.min(axis=0) - REACH
            last = cells.max(axis=0) + REACH
            own = np.array([first, last])
        covered = np.concatenate([own, self._former])
        self._former = own
        if not len(covered):
            covered = np.zeros((1, 2), int)
        return covered.min(axis=0), covered.max(axis=0)


def _cells(futures: np.ndarray) -> np.ndarray:
    """[K, M, T, 2] columns and rows of the positions of the M people who are near."""
    now = futures[0, :, 0]
    middle = np.median(now, axis=0) if len(now) else np.zeros(2)
    low = middle - WIDEST / 2
    high = middle + WIDEST / 2
    is_inside = (now > low) & (now < high)
    near = futures[:, is_inside.all(axis=1)]
    within = np.clip(near, low, high)
    return np.floor(within / CELL).astype(int)


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
    last = cells.max(axis=0) + REACH
    width, height = (last - first).max(axis=0) + 1
    middle = cells - first
    local = middle[..., None] + DISC
    column = local[:, :, 0]
    row = local[:, :, 1]
    person = np.arange(people)[:, None]
    index = (person * height + row) * width + column
    shares = np.broadcast_to(weights[:, None, None], index.shape)
    share = np.bincount(index.ravel(), shares.ravel(), people * height * width)
    share = share.reshape(people, height, width)
    # The logarithms of the probabilities that a cell is free are summed over people.
    logarithm = np.log(np.maximum(1 - share, 1e-9))
    for (x, y), part in zip(first.tolist(), logarithm):
        place = free[y : y + height, x : x + width]
        rows, columns = place.shape
        place += part[:rows, :columns]
    return 1 - np.exp(free)
