import itertools

import jax
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from neurosym_jax.errors import InputError
from neurosym_jax.symbolic.calculi import CALCULI
from neurosym_jax.symbolic.cnd import validate
from neurosym_jax.symbolic.states import (
    ABSENT,
    collapse,
    converse,
    encode_state,
    format_state,
)

CHAIN = arrays(np.int8, (9, 4), elements=st.integers(-1, 1))
QUICK = settings(max_examples=60, deadline=None)
_collapse, _validate = jax.jit(collapse), jax.jit(validate, static_argnums=2)


def valid(states, calculus):
    return rows(_validate(states, None, calculus))


def rows(chain_and_length):
    chain, length = chain_and_length
    assert not np.asarray(chain)[int(length) :].any()
    return np.asarray(chain)[: int(length)]


def chain(*texts):
    """States written such as `- 0 + -`."""
    return np.array([["-0+".index(symbol) - 1 for symbol in text.split()] for text in texts], "i1")


def test_codes_number_the_states_with_the_first_symbol_most_significant():
    np.testing.assert_array_equal(encode_state(CALCULI["c1"].states), np.arange(81))
    np.testing.assert_array_equal(encode_state(CALCULI["b1"].states), np.arange(9))
    assert int(encode_state(np.array([1, -1, -1, -1]))) == 54


def test_states_are_written():
    assert format_state(np.array([-1, 0, 1, -1])) == "- 0 + -"
    assert format_state(np.array([-1, 0, ABSENT, ABSENT]), ",") == "-,0"


def test_numbers_that_are_no_symbols_are_refused():
    with pytest.raises(InputError, match="10 is not a QTC symbol"):
        format_state(np.array([10, 10, 10, 10]))


@pytest.mark.parametrize("calculus", ["b1", "b2", "b12_1d", "c1", "c2", "c2_angle"])
def test_the_converse_of_the_converse_is_the_state_and_both_are_possible(calculus):
    states = CALCULI[calculus].states
    swapped = np.asarray(converse(states))
    np.testing.assert_array_equal(converse(swapped), states)
    assert {*map(tuple, swapped)} == {*map(tuple, states)}


def test_collapse_drops_repetitions_only():
    states = chain("- 0", "- 0", "0 0", "- 0", "- 0")
    np.testing.assert_array_equal(rows(_collapse(states)), chain("- 0", "0 0", "- 0"))
    np.testing.assert_array_equal(rows(_collapse(states, 2)), chain("- 0"))
    assert len(rows(_collapse(states, 0))) == 0


def test_absence_is_a_value_to_collapse():
    states = np.array([[1, 0, ABSENT, ABSENT], [1, 0, 0, 0]], np.int8)
    np.testing.assert_array_equal(rows(_collapse(states)), states)


def test_validate_lets_jumps_pass_through_zero_and_departures_wait():
    np.testing.assert_array_equal(valid(chain("- 0", "+ 0"), "b1"), chain("- 0", "0 0", "+ 0"))
    # q2 may not leave 0 while q1 arrives there.
    np.testing.assert_array_equal(valid(chain("- 0", "0 +"), "b1"), chain("- 0", "0 0", "0 +"))
    # Dominance allows q1 and q2 to leave 0 together.
    np.testing.assert_array_equal(valid(chain("0 0", "+ -"), "b1"), chain("0 0", "+ -"))


def test_validate_looks_at_symbols_present_in_both_states():
    states = np.array([[1, 0, ABSENT, ABSENT], [-1, 0, 1, 1]], np.int8)
    np.testing.assert_array_equal(valid(states, "bc1")[1], [0, 0, 1, 1])


@QUICK
@given(states=CHAIN, length=st.integers(1, 9))
def test_chains_are_those_of_the_plain_loop(states, length):
    """The fixed-size forms against QSRlib's formula, read state by state."""
    collapsed = [states[0]]
    for state in states[1:length]:
        if (state != collapsed[-1]).any():
            collapsed.append(state)
    expected = [collapsed[0]]
    for p, c in itertools.pairwise(collapsed):
        m = np.where(p * c == -1, 0, c)
        if ((p != 0) & (m == 0)).any():
            m = np.where(p == 0, 0, m)
        expected += [m, c] if (m != c).any() else [c]
    np.testing.assert_array_equal(rows(_collapse(states, length)), collapsed)
    np.testing.assert_array_equal(rows(_validate(*_collapse(states, length))), expected)
