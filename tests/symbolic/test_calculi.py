"""The QTC family against QSRlib's cases, exact arithmetic state by state, and its diagrams."""

import functools
import itertools
import json
from pathlib import Path
from unittest import mock

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from neurosym_jax.errors import InputError
from neurosym_jax.symbolic.calculi import (
    CALCULI,
    Calculus,
    observe,
    register_calculus,
    state_index,
)
from neurosym_jax.symbolic.cnd import adjacency, validate
from neurosym_jax.symbolic.soft import soft_symbols, state_probabilities
from neurosym_jax.symbolic.states import ABSENT, collapse, converse, format_state
from tests.symbolic import literal

A = int(ABSENT)
fixed_collapse = jax.jit(collapse)
in_diagram = jax.jit(validate, static_argnums=2)


def states(calculus):
    return CALCULI[calculus].states


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
        l[1, 1] = 1e-3  # Not quite along the line, where the symbol would be given.
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
        options = {
            "quantisation_factor": case["quantisation_factor"],
            "near": case["distance_threshold"],
        }
        chain = seen(calculus, k, l, **options)
        chains = [(chain, jnp.int32(len(chain)))]
        if not case["no_collapse"]:
            chains = [fixed_collapse(*chains[0])]
        if case["validate"]:
            chains = [in_diagram(*chains[0], calculus)]
        for found, length in chains:
            texts = [format_state(state, ",") for state in np.asarray(found)[: int(length)]]
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
@pytest.mark.parametrize("calculus", [name for name in CALCULI if name != "b12_1d"])
def test_whatever_is_observed_is_a_state_and_its_converse_is_the_others(calculus, convention):
    k, l = walks(200, seed=3)
    for factor in (0.0, 1.2):
        given = {"quantisation_factor": factor, "near": 3.0, "apart": 5.0}
        found = seen(calculus, k, l, convention, **given)
        assert np.asarray(state_index(calculus, found)).min() >= 0
        np.testing.assert_array_equal(seen(calculus, l, k, convention, **given), converse(found))


def test_on_a_line_whoever_neither_approaches_nor_leaves_stands():
    k, l = walks(200) * np.array([1, 0], np.float32)
    apart = (k[:, :-1] != l[:, :-1]).any(axis=-1)  # There is no direction between two on one spot.
    rows = np.asarray(state_index("b12_1d", seen("b12_1d", k, l)))[apart]
    assert set(rows) == set(range(17))
    assert int(state_index("b12_1d", np.array([0, 0, 1]))) == -1


@pytest.mark.parametrize(("calculus", "count", "edges"), [("bc1", 90, 929), ("bc2", 236, 3313)])
def test_a_diagram_of_pairs_near_and_apart(calculus, count, edges):
    """Apart and near each as the calculus they are of; across, by the symbols that both have."""
    rows, table = states(calculus), adjacency(calculus)
    apart = rows[:, 2] == A
    basic, double = ("b1", "c1") if calculus == "bc1" else ("b2", "c2")
    np.testing.assert_array_equal(table[np.ix_(apart, apart)], adjacency(basic))
    np.testing.assert_array_equal(table[np.ix_(~apart, ~apart)], adjacency(double))
    common = rows[:, [0, 1, *range(4, rows.shape[1])]]
    for i, j in itertools.product(np.flatnonzero(apart), np.flatnonzero(~apart)):
        same = (common[i] == common[j]).all()
        assert table[i, j] == (same or literal.may_follow(common[i], common[j]))
    assert (len(rows), table.sum()) == (count, 2 * edges)


@pytest.mark.parametrize("calculus", CALCULI)
def test_chains_move_along_the_diagram_and_change_least(calculus):
    rows, edges = states(calculus).astype(int), adjacency(calculus)
    picked = np.random.default_rng(0).integers(0, len(rows), 60)
    chain, length = in_diagram(states(calculus)[picked], 50, calculus)
    found = np.asarray(state_index(calculus, chain))[: int(length)]
    assert not np.asarray(chain)[int(length) :].any()
    assert (edges[found[1:], found[:-1]] | (found[1:] == found[:-1])).all()
    # Nothing cheaper by Floyd and Warshall: a change of symbols, or of being apart, and a state.
    apart = rows == A
    changes = np.where(apart[:, None] | apart, 0, abs(rows[:, None] - rows)).sum(axis=-1)
    crossing = apart.any(axis=1)[:, None] != apart.any(axis=1)
    cost = changes + 100 * crossing + 0.01
    least = np.where(edges, cost, np.inf)
    np.fill_diagonal(least, 0)
    for via in range(len(rows)):
        least = np.minimum(least, least[:, via, None] + least[via])
    wanted = least[picked[:49], picked[1:50]].sum()
    assert np.where(found[1:] == found[:-1], 0, cost[found[1:], found[:-1]]).sum() == (
        pytest.approx(wanted)
    )


def test_nobody_is_made_to_stop_to_become_the_slower():
    """The other's symbols go through 0 too by `validate`, to a state that there is not."""
    before, after = [-1, -1, 0, 0, 1], [0, -1, 0, 0, -1]
    chain, length = in_diagram(np.array([before, after], np.int8), None, "c2")
    between = [[-1, -1, 0, 0, 0], [-1, -1, 0, 0, -1]]
    np.testing.assert_array_equal(chain[: int(length)], [before, *between, after])


@pytest.mark.usefixtures("double")
def test_soft_states_become_the_observed_ones():
    draw = np.random.default_rng(1)
    k, l = draw.normal(size=(2, 60, 5, 2)).cumsum(axis=2)
    k[:10, 1:] = k[:10, :1]  # Some stand.
    for calculus in ("b1", "b2", "c1", "c2"):
        given = {"quantisation_factor": 0.3, "side_quantisation_factor": 0.3}
        soft = jax.jit(
            functools.partial(soft_symbols, calculus=calculus, temperature=1e-4, **given)
        )
        probable = np.asarray(jax.jit(state_probabilities, static_argnums=1)(soft(k, l), calculus))
        np.testing.assert_allclose(probable.sum(axis=-1), 1, atol=1e-9)
        found = seen(calculus, k, l, "distance", **given)
        rows = np.asarray(state_index(calculus, found))
        certain = np.take_along_axis(probable, rows[..., None], axis=-1)
        assert (certain > 0.99).mean() > 0.98

    @jax.jit
    @jax.grad
    def total(k):
        return soft_symbols(k, l, "c2", temperature=0.1, quantisation_factor=0.1)[..., 0].sum()

    gradient = total(k)
    assert np.isfinite(gradient).all()
    assert np.abs(gradient).max() > 0.1


def test_soft_states_are_the_products_of_their_symbols():
    draw = np.random.default_rng(0).dirichlet([1.0] * 3, (4, 5))
    probable = np.asarray(state_probabilities(draw, "c2"))
    np.testing.assert_allclose(probable.sum(axis=-1), 1, rtol=1e-6)
    for state, value in zip(states("c2"), probable.T):
        stands = state[0] == state[2] == 0 or state[1] == state[3] == 0
        of_symbols = [draw[:, i, q + 1] for i, q in enumerate(state[: 4 if stands else 5])]
        np.testing.assert_allclose(value, np.prod(of_symbols, axis=0), rtol=1e-5)
    for calculus in ("bc1", "c2_angle"):
        with pytest.raises(InputError, match=f"'{calculus}' has no soft form"):
            soft_symbols(np.zeros((2, 2)), np.zeros((2, 2)), calculus, temperature=0.1)


@mock.patch.dict(CALCULI)
def test_a_calculus_of_ones_own(monkeypatch):
    """Who is nearer to the origin: registered in one place, it has states, diagram and chains."""

    def nearer(k, l, convention, thresholds):
        apart = jnp.linalg.norm(k, axis=-1) - jnp.linalg.norm(l, axis=-1)
        return jnp.sign(apart[..., 1:, None]).astype(jnp.int8)

    register_calculus("nearer", Calculus(("nearer",), nearer))
    found = observe(*walks(3), "nearer")
    assert found.shape == (3, 6, 1)
    np.testing.assert_array_equal(adjacency("nearer"), [[0, 1, 0], [1, 0, 1], [0, 1, 0]])
    chain, length = validate(np.array([[-1], [1]], np.int8), None, "nearer")
    np.testing.assert_array_equal(chain[: int(length)], [[-1], [0], [1]])


def test_what_is_unknown_is_refused():
    zeros = np.zeros((2, 2))
    with pytest.raises(InputError, match=r"unknown calculus 'c3': .*there are b1, b2"):
        observe(zeros, zeros, "c3")
    with pytest.raises(InputError, match=r"unknown threshold 'far': there are quantisation_factor"):
        observe(zeros, zeros, "bc1", far=2.0)
    with pytest.raises(InputError, match="unknown QTC convention 'lines'"):
        observe(zeros, zeros, "bc2", convention="lines")  # pyright: ignore
