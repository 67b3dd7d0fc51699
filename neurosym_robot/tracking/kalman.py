"""Who goes on as whom: a Kalman filter of constant velocity with gated, global assignment.

Each person's place and velocity are predicted to the moment of a frame. Detections near
enough are given to people so that all together are most probable. Of who was seen only
once no velocity is known: a detection that nobody else takes may be of them, if they
run. The others are new. The error of detections is learned from those that are given.
"""

import dataclasses
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from neurosym_jax.configuration import Checked, NotNegative
from neurosym_robot.tracking.following import FAR

CROWD = 512
"""People followed at once; of more, those that come later get a new id in every frame."""
PACE = 1.0
"""Standard deviation of a newcomer's velocity along an axis, m/s."""
NOISE = 0.1
"""Standard deviation of a detection along an axis, metres, before any was learned."""
LEAST = 0.05
"""Least standard deviation of a detection that is learned, metres."""
RATE = 0.01
"""Weight of one detection in what is learned."""
BRIEF = 0.25
"""Seconds between two detections of a person from which the error is learned."""
GATE = 3.5
"""Standard deviations between a detection and a person at most."""
RUN, BLINK = 10.0, 0.5
"""Speed between somebody's first two detections, m/s, and seconds between these, at most."""
NEVER = 1e6
"""Cost of a pair that cannot be."""


@dataclasses.dataclass(frozen=True)
class LinkOptions(Checked):
    """When two detections may be of one person."""

    max_gap: NotNegative = 4.0
    """Seconds for which a person out of sight is remembered."""
    reach: NotNegative = 0.8
    """Maximum distance in metres from where the person is expected, for a gap of 0 s."""
    drift: NotNegative = 0.6
    """Metres added to --reach for each second of the gap."""
    acceleration: NotNegative = 0.3
    """How fast velocities change: standard deviation after a second, m/s."""


class _People(NamedTuple):
    """P people when they were seen last."""

    number: np.ndarray  # [P] int64
    stamp: np.ndarray  # [P] seconds
    place: np.ndarray  # [P, 2] metres
    velocity: np.ndarray  # [P, 2] metres per second
    covariance: np.ndarray  # [P, 2, 2] of place and velocity along either axis

    def take(self, rows: np.ndarray) -> "_People":
        return _People(*(values[rows] for values in self))

    def and_others(self, others: "_People") -> "_People":
        return _People(*(np.concatenate(pair) for pair in zip(self, others)))


class KalmanFilter:
    """Gives the detections of each frame the numbers of people, counted from 0."""

    def __init__(self, options: LinkOptions | None = None, crowd: int = CROWD):
        """Follow up to `crowd` people."""
        self.options = LinkOptions() if options is None else options
        self._crowd, self._next, self._stamp = crowd, 0, -np.inf
        self._people = _newcomers(np.zeros((0, 2)), 0, 0.0, NOISE)
        self._square = 2 * NOISE**2  # mean squared error of a detection, both axes

    @property
    def noise(self) -> float:
        """Standard deviation of a detection along an axis, metres."""
        return max(LEAST, float(np.sqrt(self._square / 2)))

    @property
    def numbers(self) -> np.ndarray:
        """[P] numbers of the people who are remembered."""
        return self._people.number

    def push(self, stamp: float, xy: ArrayLike) -> np.ndarray:
        """[N] int64 numbers of people at `xy [N, 2]` metres.

        A clock set back begins anew. Who is not followed has a new number: all of a
        frame with the stamp of the one before, and places that are none.
        """
        xy = np.asarray(xy, np.float64).reshape(-1, 2)
        numbers = np.full(len(xy), -1)
        if np.isfinite(stamp) and stamp != self._stamp:
            gap = stamp - self._people.stamp
            is_recent = gap <= self.options.max_gap + 1e-6
            is_recent &= stamp > self._stamp
            self._people = self._people.take(is_recent)
            self._stamp = stamp
            is_near = (np.abs(xy) < FAR).all(axis=1)
            near = np.flatnonzero(is_near)[: self._crowd]
            numbers[near] = self._follow(xy[near])

        others = np.flatnonzero(numbers < 0)
        numbers[others] = self._next + np.arange(len(others))
        self._next += len(others)
        return numbers

    def _follow(self, xy: np.ndarray) -> np.ndarray:
        """[N] numbers of the people at `xy`; -1 for who finds no room."""
        people = len(self._people.number)
        expected, cost = self._predict(xy)
        row, column = _assigned(cost)
        seen = self._update(expected.take(row), xy[column])
        numbers = np.full(len(xy), -1)
        numbers[column] = seen.number

        # Detections that nobody takes may be of people who were seen once, and run.
        left = np.setdiff1d(np.arange(people), row)
        free = np.flatnonzero(numbers < 0)
        newcomer, other = _assigned(self._running(left, xy[free]))
        runners = self._people.take(left[newcomer])
        taken = free[other]
        running = self._start(runners, xy[taken])
        numbers[taken] = running.number

        # The others are new, as far as there is room.
        room = max(self._crowd - people, 0)
        new = np.flatnonzero(numbers < 0)[:room]
        fresh = _newcomers(xy[new], self._next, self._stamp, self.noise)
        numbers[new] = fresh.number
        self._next += len(new)

        unseen = np.delete(left, newcomer)
        lost = self._people.take(unseen)
        self._people = lost.and_others(seen).and_others(running).and_others(fresh)
        return numbers

    def _predict(self, xy: np.ndarray) -> tuple[_People, np.ndarray]:
        """The people now, and [P, N] costs: minus twice the logarithm of a density."""
        people = self._people
        options = self.options
        gap = self._stamp - people.stamp
        step = np.tile(np.eye(2), (len(gap), 1, 1))
        step[:, 0, 1] = gap
        doubt = _matrices(gap**3 / 3, gap**2 / 2, gap)
        covariance = step @ people.covariance @ step.swapaxes(1, 2)
        covariance += options.acceleration**2 * doubt
        place = people.place + gap[:, None] * people.velocity
        expected = people._replace(place=place, covariance=covariance)

        variance = covariance[:, :1, 0] + self.noise**2
        off = _distances(place, xy)
        gate = GATE * np.sqrt(variance)
        reach = options.reach + options.drift * gap[:, None]
        is_near = (off <= gate) & (off <= reach)
        cost = off**2 / variance + 2 * np.log(variance)
        return expected, np.where(is_near, cost, NEVER)

    def _running(self, rows: np.ndarray, xy: np.ndarray) -> np.ndarray:
        """[R, N] distances of `xy [N, 2]` from people who were seen once, as far as they run."""
        people = self._people.take(rows)
        gap = self._stamp - people.stamp
        off = _distances(people.place, xy)
        # An update makes the velocity better known than that.
        is_newcomer = people.covariance[:, 1, 1] == PACE**2
        may_run = is_newcomer & (gap <= BLINK)
        reach = RUN * gap[:, None]
        can_be = may_run[:, None] & (off <= reach)
        return np.where(can_be, off, NEVER)

    def _start(self, people: _People, xy: np.ndarray) -> _People:
        """People [P] who were seen once, with the velocity that two detections say."""
        gap = self._stamp - people.stamp
        rate = 1 / gap
        covariance = _matrices(np.ones_like(gap), rate, 2 * rate**2)
        return people._replace(
            stamp=np.full(len(xy), self._stamp),
            place=xy,
            velocity=(xy - people.place) / gap[:, None],
            covariance=self.noise**2 * covariance,
        )

    def _update(self, expected: _People, xy: np.ndarray) -> _People:
        """The people `expected` [P] after detections of them at `xy`."""
        off = xy - expected.place
        variance = expected.covariance[:, 0, 0] + self.noise**2
        gain = expected.covariance[:, :, 0] / variance[:, None]
        known = gain[:, :, None] * expected.covariance[:, :1]
        covariance = expected.covariance - known

        is_brief = self._stamp - expected.stamp < BRIEF
        squares = (off[is_brief] ** 2).sum(axis=1)
        for square in squares:
            # An outlier counts as three standard deviations.
            square = min(square, 9 * self._square)
            self._square += RATE * (square - self._square)
        return expected._replace(
            stamp=np.full(len(xy), self._stamp),
            place=expected.place + gain[:, :1] * off,
            velocity=expected.velocity + gain[:, 1:] * off,
            covariance=covariance,
        )


def _matrices(first: np.ndarray, off: np.ndarray, second: np.ndarray) -> np.ndarray:
    """[P, 2, 2] symmetric matrices: [P] on the diagonal, and `off` [P] beside it."""
    matrices = np.array([[first, off], [off, second]])
    return np.moveaxis(matrices, -1, 0)


def _distances(place: np.ndarray, xy: np.ndarray) -> np.ndarray:
    """[P, N] distances of `xy [N, 2]` from people at `place [P, 2]`."""
    offset = xy - place[:, None]
    return np.linalg.norm(offset, axis=-1).reshape(len(place), len(xy))


def _assigned(cost: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Rows and columns of the cheapest pairs of `cost [R, C]`, as many as can be."""
    can_be = cost < NEVER
    row, column = np.nonzero(can_be)
    # Most pairs have no rival; the others are few.
    in_row = can_be.sum(axis=1)
    in_column = can_be.sum(axis=0)
    rivals = in_row[row] + in_column[column] > 2
    rows = np.unique(row[rivals])
    columns = np.unique(column[rivals])
    part = cost[np.ix_(rows, columns)]
    one, other = cheapest_pairs(part)

    row = np.concatenate([row[~rivals], rows[one]])
    column = np.concatenate([column[~rivals], columns[other]])
    order = np.argsort(row)
    row, column = row[order], column[order]
    is_pair = can_be[row, column]
    return row[is_pair], column[is_pair]


def cheapest_pairs(cost: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Rows and columns of the assignment of least cost, by shortest augmenting paths.

    As `scipy.optimize.linear_sum_assignment`, whose import takes half a second of a
    processor and 36 MB of a robot without JAX. `cost [R, C]` is finite.
    """
    if cost.shape[0] > cost.shape[1]:
        column, row = cheapest_pairs(cost.T)
        return row, column
    rows, columns = cost.shape
    row_price, column_price = np.zeros(rows), np.zeros(columns)
    owner = np.full(columns, -1)  # the row of each column
    for first in range(rows):
        distance = np.full(columns, np.inf)
        before = np.full(columns, -1)  # the column before it on the path, if any
        is_done = np.zeros(columns, bool)
        row, column, length = first, -1, 0.0
        while row >= 0:
            onward = length + cost[row] - row_price[row] - column_price
            is_nearer = ~is_done & (onward < distance)
            distance[is_nearer] = onward[is_nearer]
            before[is_nearer] = column
            waiting = np.where(is_done, np.inf, distance)
            column = int(waiting.argmin())
            length = distance[column]
            row = owner[column]
            is_done[column] = row >= 0
        change = length - distance[is_done]
        row_price[first] += length
        row_price[owner[is_done]] += change
        column_price[is_done] -= change
        while column >= 0:
            previous = before[column]
            owner[column] = first if previous < 0 else owner[previous]
            column = previous
    chosen = np.flatnonzero(owner >= 0)
    return owner[chosen], chosen


def _newcomers(xy: np.ndarray, first: int, stamp: float, noise: float) -> _People:
    """People who are seen for the first time, numbered from `first` on."""
    count = len(xy)
    return _People(
        number=first + np.arange(count),
        stamp=np.full(count, stamp),
        place=xy,
        velocity=np.zeros((count, 2)),
        covariance=np.tile(np.diag([noise**2, PACE**2]), (count, 1, 1)),
    )
