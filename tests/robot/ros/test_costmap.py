"""A costmap has the probabilities of the draws, and clears what it said before."""

import numpy as np
import pytest

from neurosym_robot.ros.costmap import CELL, FADE, WIDEST, Costmap

EVENLY = np.array([0.5, 0.5])


def ways(*people) -> np.ndarray:
    """[K, N, T, 2] of people, each given by K ways of T positions."""
    return np.array(people, float).swapaxes(0, 1)


def reader(grid: np.ndarray, corner: np.ndarray):
    """A function that returns the per cent at x, y."""

    def at(x: float, y: float) -> int:
        column, row = np.floor((np.array([x, y]) - corner) / CELL + 1e-6).astype(int)
        return int(grid[row, column])

    return at


def test_a_cell_is_as_full_as_the_draws_say():
    """The first may turn to the left or to the right; the other stands."""
    one = [[(1, 0), (2, 1)], [(1, 0), (2, -1)]]
    other = [[(9, 5), (9, 5)], [(9, 5), (9, 5)]]
    at = reader(*Costmap().update(ways(one, other), EVENLY, 0.4))
    assert at(1, 0) == at(1, 0.3) == at(9, 5) == 100
    assert at(2, 1) == at(2, -1) == round(50 * np.exp(-0.4 / FADE))
    assert at(2, 0) == at(5, 3) == at(9, 4) == 0


def test_a_layer_is_of_one_moment():
    """After 0.4 s they have left where they stand now."""
    futures = ways([[(0, 0), (2, 0), (4, 0)]] * 2)
    for ahead, place in ((0.0, 0), (0.4, 2), (0.7, 4), (0.8, 4), (9.0, 4)):
        at = reader(*Costmap(ahead).update(futures, EVENLY, 0.4))
        assert [at(x, 0) for x in (0, 2, 4)] == [100 * (x == place) for x in (0, 2, 4)]


def test_two_people_are_somebody_unless_neither_is_there():
    people = [[[(0, 0)], [(3, 0)]], [[(0, 0)], [(-3, 0)]], [[(0, 0)], [(0, 3)]]]
    at = reader(*Costmap().update(ways(*people), np.array([0.3, 0.7]), 0.4))
    assert at(0, 0) == round(100 * (1 - 0.7**3))
    assert at(3, 0) == 70


@pytest.mark.parametrize("far", [0.0, 5e5])
def test_nobody_clears_what_was_said_before(far):
    """Once; then a single cell says that the node is alive."""
    costmap, nobody = Costmap(), np.zeros((2, 0, 2, 2))
    alone = ways([[(far, 0), (far + 1, 0)]] * 2)
    full, corner = costmap.update(alone, EVENLY, 0.4)
    assert full.max() == 100
    empty, place = costmap.update(nobody, EVENLY, 0.4)
    assert (empty.shape, empty.max()) == (full.shape, 0)
    np.testing.assert_allclose(place, corner)
    assert costmap.update(nobody, EVENLY, 0.4)[0].tolist() == [[0]]


def test_who_walks_away_leaves_no_trace():
    costmap = Costmap()
    costmap.update(ways([[(0, 0)]] * 2), EVENLY, 0.4)
    at = reader(*costmap.update(ways([[(7, 0)]] * 2), EVENLY, 0.4))
    assert (at(0, 0), at(7, 0)) == (0, 100)


def test_a_grid_is_bounded():
    people = [[[(x, 0)]] * 2 for x in (0, 1, 2, 1e6)]
    grid, _ = Costmap().update(ways(*people), EVENLY, 0.4)
    assert max(grid.shape) < WIDEST / CELL
    astray = ways([[(0, 0), (1e9, 0)]] * 2)
    assert max(Costmap().update(astray, EVENLY, 0.4)[0].shape) <= WIDEST / CELL + 20
