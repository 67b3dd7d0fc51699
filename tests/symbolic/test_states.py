"""States and chains, and the conceptual neighbourhood diagrams with the weights from them."""

import itertools

import jax.numpy as jnp
import numpy as np
import pytest

from neurosym_jax.symbolic.cnd import adjacency, alpha_table
from neurosym_jax.symbolic.states import (
    ABSENT,
    CALCULI,
    all_states,
    encode_state,
    format_state,
    state_index,
)
from neurosym_jax.symbolic.weightings import CndShipped
from tests.symbolic import literal


def test_states_have_codes_rows_and_texts():
    assert int(encode_state(np.array([1, -1, -1, -1]))) == 54
    for calculus in CALCULI:
        rows = all_states(calculus)
        np.testing.assert_array_equal(state_index(calculus, jnp.asarray(rows)), range(len(rows)))
    assert format_state(np.array([-1, 0, 1, -1])) == "- 0 + -"
    assert format_state(np.array([-1, 0, ABSENT, ABSENT]), ",") == "-,0"


@pytest.mark.parametrize(("calculus", "edges"), [("b1", 16), ("c1", 544)])
def test_states_and_edges_are_those_of_the_theory(calculus, edges):
    rows = literal.states(calculus)
    np.testing.assert_array_equal(all_states(calculus), rows)
    np.testing.assert_array_equal(adjacency(calculus), literal.neighbours(rows))
    assert adjacency(calculus).sum() == 2 * edges
    # By continuity alone there are more.
    if calculus == "c1":
        expected = np.array(literal.neighbours(rows, "continuity"))
        np.testing.assert_array_equal(adjacency("c1", "continuity"), expected)
        assert expected.sum() == 2 * 1160


def test_a_diagram_of_pairs_near_and_apart():
    """Apart and near each as the calculus they are of; across, by the symbols that both have."""
    rows, table = all_states("bc1"), adjacency("bc1")
    apart = rows[:, 2] == ABSENT
    np.testing.assert_array_equal(table[np.ix_(apart, apart)], adjacency("b1"))
    np.testing.assert_array_equal(table[np.ix_(~apart, ~apart)], adjacency("c1"))
    for i, j in itertools.product(np.flatnonzero(apart), np.flatnonzero(~apart)):
        same = (rows[i, :2] == rows[j, :2]).all()
        assert table[i, j] == (same or literal.may_follow(rows[i, :2], rows[j, :2]))
    assert (len(rows), table.sum()) == (90, 2 * 929)


def test_alphas():
    rows = literal.states("c1")
    expected = [1 / [15, 9, 11, 27, 80][state.count(0)] for state in rows]
    np.testing.assert_array_equal(alpha_table(), expected)
    degrees = np.array([sum(row) for row in literal.neighbours(rows)])
    np.testing.assert_array_equal(alpha_table(), 1 / degrees)
    np.testing.assert_array_equal(alpha_table(include_self=True), 1 / (degrees + 1))
    shipped = [literal.shipped_alpha(state) for state in rows]
    np.testing.assert_array_equal(CndShipped().state_weights(), shipped)
