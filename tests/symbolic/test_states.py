import itertools

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from neurosym_jax.symbolic.calculi import CALCULI
from neurosym_jax.symbolic.states import ABSENT, collapse, encode_state, format_state, validate


def chain(*texts):
    """States written such as `- 0 + -`; `x` is absent."""
    values = {"-": -1, "0": 0, "+": 1, "x": int(ABSENT)}
    return np.array([[values[symbol] for symbol in text.split()] for text in texts], "i1")


def test_codes_number_the_states_with_the_first_symbol_most_significant():
    np.testing.assert_array_equal(encode_state(CALCULI["c1"].states), np.arange(81))
    np.testing.assert_array_equal(encode_state(CALCULI["b1"].states), np.arange(9))
    assert int(encode_state(np.array([1, -1, -1, -1]))) == 54
    assert format_state(chain("- 0 + -")[0]) == "- 0 + -"
    assert format_state(chain("- 0 x x")[0], ",") == "-,0"


@pytest.mark.parametrize(
    ("given", "wanted"),
    [
        (("- 0", "+ 0"), ("- 0", "0 0", "+ 0")),
        (("- 0", "0 +"), ("- 0", "0 0", "0 +")),  # q2 may not leave 0 while q1 arrives there.
        (("0 0", "+ -"), ("0 0", "+ -")),  # They may leave 0 together.
        (("+ 0 x x", "- 0 + +"), ("+ 0 x x", "0 0 + +", "- 0 + +")),
    ],
)
def test_validate_lets_jumps_pass_through_zero_and_departures_wait(given, wanted):
    found = validate(chain(*given))
    np.testing.assert_array_equal(found, chain(*wanted))
    assert found.dtype == np.int8


def test_collapse_drops_repetitions_only():
    states = chain("- 0", "- 0", "0 0", "- 0", "- 0")
    np.testing.assert_array_equal(collapse(states), chain("- 0", "0 0", "- 0"))
    assert len(collapse(states[:0])) == 0
    absent = chain("+ 0 x x", "+ 0 0 0")
    np.testing.assert_array_equal(collapse(absent), absent)


@given(
    states=arrays(np.int8, st.tuples(st.integers(1, 9), st.just(4)), elements=st.integers(-1, 1))
)
def test_chains_are_those_of_the_plain_loop(states):
    """QSRlib's formula, read state by state."""
    collapsed = [states[0]]
    for state in states[1:]:
        if (state != collapsed[-1]).any():
            collapsed.append(state)
    valid = [collapsed[0]]
    for p, c in itertools.pairwise(collapsed):
        m = np.where(p * c == -1, 0, c)
        if ((p != 0) & (m == 0)).any():
            m = np.where(p == 0, 0, m)
        valid += [m, c] if (m != c).any() else [c]
    np.testing.assert_array_equal(collapse(states), collapsed)
    np.testing.assert_array_equal(validate(collapse(states)), valid)
