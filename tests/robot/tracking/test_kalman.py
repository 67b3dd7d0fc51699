"""The filter follows people through noise and gaps, and learns how noisy detections are."""

import itertools

import numpy as np
import pytest
from scipy.optimize import linear_sum_assignment

from neurosym_robot.tracking.kalman import NEVER, KalmanFilter, _assigned

PLACES = np.array([[0.0, 0.0], [0.0, 1.0], [6.0, 0.5]])
SPEEDS = np.array([[1.0, 0.0], [1.0, 0.0], [-1.0, 0.0]])


def follow(filter, noise=0.0, frames=60, seen=lambda n: slice(None)):
    """[F] numbers given to three people, two abreast and one towards them, who walk on."""
    rng, rows = np.random.default_rng(0), []
    for n in range(frames):
        xy = PLACES + n / 10 * SPEEDS + rng.normal(0, noise, (3, 2))
        order = rng.permutation(3)[seen(n)]
        numbers = filter.push(n / 10, xy[order])
        rows.append(dict(zip(order.tolist(), numbers.tolist())))
    return rows


@pytest.mark.parametrize("noise", [0.0, 0.05, 0.12])
def test_people_keep_their_numbers_where_others_cross(noise):
    rows = follow(KalmanFilter(), noise)
    for person in range(3):
        assert len({row[person] for row in rows}) == 1


@pytest.mark.parametrize(("lost", "people"), [(30, 3), (45, 6)])
def test_who_is_lost_for_three_seconds_comes_back_and_later_is_new(lost, people):
    def seen(n):
        return slice(3) if n < 20 or n >= 20 + lost else slice(0)

    rows = follow(KalmanFilter(), 0.03, 90, seen=seen)
    assert len(set(itertools.chain(*(row.values() for row in rows)))) == people


def test_the_error_of_detections_is_learned():
    for noise in (0.05, 0.15, 0.25):
        filter = KalmanFilter()
        follow(filter, noise, 300)
        # With a share of the prediction's own error.
        assert filter.noise == pytest.approx(noise, rel=0.35)


def test_an_empty_frame_and_a_clock_set_back():
    filter = KalmanFilter()
    assert filter.push(0.0, np.zeros((0, 2))).tolist() == []
    (first,) = filter.push(0.1, [[0.0, 0.0]])
    assert filter.push(0.2, np.zeros((0, 2))).tolist() == []
    assert filter.push(0.3, [[0.0, 0.0]]).tolist() == [first]
    assert filter.push(0.1, [[0.0, 0.0]]).tolist() != [first]


@pytest.mark.parametrize(
    ("rate", "speed"), [(10, 4.5), (10, 8), (5, 6), (2.5, 3), (2.5, 6), (2.5, 9)]
)
def test_who_runs_is_one_person_from_the_first_frame(rate, speed):
    rng, filter = np.random.default_rng(0), KalmanFilter()
    numbers = set()
    for frame in range(int(4 * rate)):
        place = np.array([[speed * frame / rate, 0.0]]) + rng.normal(0, 0.03, (1, 2))
        numbers.update(filter.push(frame / rate, place).tolist())
    assert len(numbers) == 1


def test_who_appears_elsewhere_does_not_run():
    """At 11 m/s, or after a second, it is somebody else; and beside a walker, never."""
    for frames in ([(0.0, 0.0), (0.4, 4.6)], [(0.0, 0.0), (1.1, 5.0)]):
        filter = KalmanFilter()
        numbers = [filter.push(time, [[x, 0.0]]).item() for time, x in frames]
        assert numbers[0] != numbers[1]
    filter = KalmanFilter()
    walker, other = filter.push(0.0, [[0.0, 0.0], [5.0, 0.0]]).tolist()
    assert filter.push(0.4, [[0.5, 0.0], [2.0, 0.0]]).tolist() == [walker, other]


def test_pairs_are_those_of_scipy():
    """As many pairs as can be, at the least cost, in crowds of any density."""
    rng = np.random.default_rng(0)
    rivals = 0
    for number in range(400):
        shape = rng.integers(0, 12, 2)
        cost = rng.normal(0, 5, shape)
        cost[rng.random(shape) < rng.choice([0.0, 0.5, 0.8, 0.95])] = NEVER
        if number % 2:
            cost = np.round(cost)  # Some pairs cost the same.
        row, column = _assigned(cost)
        assert len(np.unique(row)) == len(np.unique(column)) == len(row)
        best = cost[linear_sum_assignment(cost)]
        best = best[best < NEVER]
        assert len(row) == len(best)
        assert cost[row, column].sum() == pytest.approx(best.sum())
        rivals += len(row) > 1 and (cost < NEVER).sum() > len(row)
    assert rivals > 100
