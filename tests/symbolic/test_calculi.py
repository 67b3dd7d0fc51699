"""The QTC family against QSRlib's cases and exact arithmetic, state by state."""

import functools
import itertools
import json
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from neurosym_jax.errors import InputError
from neurosym_jax.symbolic.calculi import CALCULI, observe, state_index
from neurosym_jax.symbolic.cnd import adjacency
from neurosym_jax.symbolic.states import ABSENT, collapse, format_state, validate
from tests.symbolic import literal

A = int(ABSENT)


@functools.partial(jax.jit, static_argnames=("calculus", "convention"))
def seen(calculus, k, l, convention="line", **thresholds):
    return observe(k, l, calculus, convention=convention, **thresholds)


def walks(pairs, seed=0, steps=7, reach=2):
    """Integer walks [2, pairs, steps, 2] in which people stand, meet and walk on lines."""
    draw = np.random.default_rng(seed)
    moves = draw.integers(-reach, reach + 1, (2, pairs, steps, 2))
    moves *= draw.integers(0, 2, (2, pairs, steps, 1))
    return moves.cumsum(axis=2).astype(np.float32)


@pytest.fixture(scope="module")
def oracle():
    k, l = walks(200)
    return k, l, np.array([literal.six_symbols(*pair) for pair in zip(k.tolist(), l.tolist())])


@pytest.mark.rounding
@pytest.mark.parametrize(
    ("calculus", "symbols"),
    [("b1", [0, 1]), ("c1", [0, 1, 2, 3]), ("c2", [0, 1, 2, 3, 4]), ("c2_angle", range(6))],
)
def test_every_symbol_is_that_of_exact_arithmetic(oracle, calculus, symbols):
    k, l, expected = oracle
    np.testing.assert_array_equal(seen(calculus, k, l), expected[..., list(symbols)])
    assert len(np.unique(expected.reshape(-1, 6), axis=0)) > 150


@pytest.mark.rounding
def test_relative_speed_without_sides_is_of_the_steps_alone():
    k, l = walks(200)
    square = [(np.diff(x, axis=-2) ** 2).sum(axis=-1) for x in (k, l)]
    found = np.asarray(seen("b2", k, l))
    np.testing.assert_array_equal(found[..., 2], np.sign(square[0] - square[1]))
    np.testing.assert_array_equal(found[..., :2], seen("b1", k, l))
    slower = seen("b2", k, l, quantisation_factor=1.5)[..., 2]
    length = np.sqrt(square)
    np.testing.assert_array_equal(slower, np.sign(np.trunc((length[0] - length[1]) / 1.5001)))


def test_an_angle_counts_from_its_threshold_on():
    line = np.array([[0.0, 0], [1, 0]]), np.array([[10.0, 0], [9, 0]])
    for degrees, threshold, expected in ((10, 0, 1), (10, 11, 0), (10, 9, 1), (80, 79, 1)):
        k, l = line[0].copy(), line[1].copy()
        k[1] = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
        l[1, 1] = 1e-3  # Not quite along the line, where q1 to q4 decide.
        found = seen("c2_angle", k, l, angle=np.radians(threshold))[0]
        assert int(found[5]) == expected


@pytest.mark.usefixtures("double")
@pytest.mark.parametrize(
    ("qsrlib", "calculus"), [("qtcbs", "b1"), ("qtccs", "c1"), ("qtcbcs", "bc1")]
)
def test_qsrlibs_own_cases(qsrlib, calculus):
    stored = json.loads((Path(__file__).parents[1] / "golden" / "qsrlib.json").read_text())
    cases = [case for case in stored["cases"] if case["calculus"] == qsrlib]
    assert len(cases) == 14
    for case in cases:
        people = stored["recordings"][case["recording"]]
        k, l = (np.array(people[case[name]]) for name in "kl")
        near = {"near": case["distance_threshold"]}
        chain = seen(calculus, k, l, quantisation_factor=case["quantisation_factor"], **near)
        chain = np.asarray(chain) if case["no_collapse"] else collapse(chain)
        chain = validate(chain) if case["validate"] else chain
        texts = [format_state(state, ",") for state in chain]
        assert texts == case["expected"].split(), case


def test_sides_come_and_go_with_hysteresis():
    distance = np.array([9, 5, 4, 2, 4, 5, 4, 2, 9.0])
    k, l = np.zeros((9, 2)), np.stack([distance, np.zeros(9)], axis=-1)

    def near(**thresholds):
        return (np.asarray(seen("bc1", k, l, **thresholds))[:, 2] != A).astype(int).tolist()

    assert near(near=3.0) == [0, 0, 1, 0, 0, 0, 1, 0]
    assert near(near=3.0, apart=4.5) == [0, 0, 1, 1, 0, 0, 1, 0]
    assert near(near=4.0) == [0, 1, 1, 1, 0, 1, 1, 0]  # At the threshold a pair is near.
    plain, with_speed = seen("bc1", k, l, near=3.0), seen("bc2", k, l, near=3.0)
    np.testing.assert_array_equal(np.asarray(with_speed)[:, :4], plain)
    assert (np.asarray(with_speed)[:-1, 4] == -1).all()
    assert plain.dtype == jnp.int8


@pytest.mark.parametrize("convention", ["distance", "line"])
@pytest.mark.parametrize("calculus", list(CALCULI))
def test_observations_are_states_and_those_of_the_other_their_converse(calculus, convention):
    k, l = walks(200, seed=3)
    for factor in (0.0, 1.2):
        given = {"quantisation_factor": factor, "near": 3.0, "apart": 5.0}
        found = seen(calculus, k, l, convention, **given)
        assert np.asarray(state_index(calculus, found)).min() >= 0
        other_way = seen(calculus, l, k, convention, **given)
        np.testing.assert_array_equal(other_way, literal.converse(found))


@pytest.mark.parametrize(("calculus", "count", "edges"), [("bc1", 90, 929), ("bc2", 236, 3313)])
def test_a_diagram_of_pairs_near_and_apart(calculus, count, edges):
    """Apart and near each as the calculus they are of; across, by the symbols that both have."""
    rows, table = CALCULI[calculus].states, adjacency(calculus)
    apart = rows[:, 2] == A
    basic, double = ("b1", "c1") if calculus == "bc1" else ("b2", "c2")
    np.testing.assert_array_equal(table[np.ix_(apart, apart)], adjacency(basic))
    np.testing.assert_array_equal(table[np.ix_(~apart, ~apart)], adjacency(double))
    common = rows[:, [0, 1, *range(4, rows.shape[1])]]
    for i, j in itertools.product(np.flatnonzero(apart), np.flatnonzero(~apart)):
        same = (common[i] == common[j]).all()
        assert table[i, j] == (same or literal.may_follow(common[i], common[j]))
    assert (len(rows), table.sum()) == (count, 2 * edges)


PAIR = np.zeros((2, 2)), np.zeros((2, 2))


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: observe(*PAIR, "c3"), r"unknown calculus 'c3': .*there are b1, b2"),
        (lambda: observe(*PAIR, "bc1", far=2.0), "unknown threshold 'far': there are quantis"),
        (lambda: observe(*PAIR, "bc2", convention="lines"), "unknown QTC convention 'lines'"),
        (lambda: adjacency("c1", "any"), r"'any'.*dominance, continuity"),
        (lambda: format_state(np.array([10, 10])), "10 is not a QTC symbol"),
    ],
)
def test_refusals(call, message):
    with pytest.raises(InputError, match=message):
        call()
