import numpy as np
import pytest

from neurosym_jax.symbolic.calculi import CALCULI
from neurosym_jax.symbolic.cnd import adjacency, alpha_table
from neurosym_jax.symbolic.state_weightings import CndShipped
from tests.symbolic import literal

SIZES = {
    "b1": (9, 16),
    "b2": (27, 98),
    "c1": (81, 544),
    "c2": (209, 1568),
    "c2_angle": (305, 2400),
}


@pytest.mark.parametrize("calculus", SIZES)
def test_states_and_edges_are_those_of_the_theory(calculus):
    rows = literal.states(calculus)
    np.testing.assert_array_equal(CALCULI[calculus].states, rows)
    np.testing.assert_array_equal(adjacency(calculus), literal.neighbours(rows))
    count, edges = SIZES[calculus]
    assert (len(rows), adjacency(calculus).sum()) == (count, 2 * edges)


def test_continuity_alone_has_more_edges():
    expected = np.array(literal.neighbours(literal.states("c1"), "continuity"))
    np.testing.assert_array_equal(adjacency("c1", "continuity"), expected)
    assert expected.sum() == 2 * 1160


def test_alphas():
    rows = literal.states("c1")
    expected = [1 / [15, 9, 11, 27, 80][state.count(0)] for state in rows]
    np.testing.assert_array_equal(alpha_table(), expected)
    degrees = np.array([sum(row) for row in literal.neighbours(rows)])
    np.testing.assert_array_equal(alpha_table(), 1 / degrees)
    np.testing.assert_array_equal(alpha_table(include_self=True), 1 / (degrees + 1))
    shipped = [literal.shipped_alpha(state) for state in rows]
    np.testing.assert_array_equal(CndShipped().state_weights(), shipped)


def test_tables_are_made_once_and_read_only():
    assert alpha_table() is alpha_table()
    for table in (CALCULI["b1"].states, adjacency("b1"), alpha_table("b1")):
        with pytest.raises(ValueError, match="read-only"):
            table[0] = 0
