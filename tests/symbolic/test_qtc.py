"""Symbols, states, diagrams and weights against plain loops, QSRlib and the released code."""

import functools
import itertools
import json
import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from neurosym_jax.errors import InputError
from neurosym_jax.symbolic.forecast import symbolic_forecast
from neurosym_jax.symbolic.qtc import (
    ABSENT,
    adjacency,
    all_states,
    alpha_table,
    collapse,
    encode_state,
    format_state,
    observe,
    state_index,
    state_texts,
    validate,
)
from neurosym_jax.symbolic.weighting import CndShipped, make_weighting
from tests.repository import GOLDEN
from tests.symbolic import literal

CONVENTIONS = literal.CONVENTIONS
GRID = arrays(np.float32, (2, 6, 2), elements=st.integers(-20, 20).map(float))


@functools.partial(jax.jit, static_argnames=("convention", "calculus", "distances"))
def c1(k, l, convention="distance", calculus="c1", **options):
    return observe(k, l, calculus, convention=convention, **options)


b1 = functools.partial(c1, calculus="b1")


@functools.partial(jax.jit, static_argnames="convention")
def pairs(positions, convention="distance"):
    return observe(positions[:, None], positions, convention=convention)


@pytest.mark.rounding
@pytest.mark.parametrize("x64", [False, True])
@pytest.mark.parametrize("thresholds", [(0.0, None), (0.125, None), (0.25, 0.125)])
@pytest.mark.parametrize("convention", CONVENTIONS)
def test_every_symbol_is_that_of_the_definition(convention, thresholds, x64):
    factor, side = thresholds
    factors = {"quantisation_factor": factor, "side_quantisation_factor": side}
    # One shape, to be compiled once: after their step kings stand.
    walks = []
    for steps, walk in zip(literal.unit_steps(), literal.grid_walks(200)):
        kings = [path + path[-1:] * 6 for path in steps]
        walks.append(kings + walk)
    expected = [
        literal.symbols(*pair, convention, factor, side) for pair in zip(*walks)
    ]
    with jax.enable_x64(x64):
        states = c1(*map(np.array, walks), convention=convention, **factors)
    np.testing.assert_array_equal(states, expected)
    assert (np.array(expected)[81:] == 0).mean(axis=(0, 1)).min() > 0.1


@pytest.mark.rounding
@pytest.mark.parametrize("x64", [False, True])
def test_real_windows_are_exact_in_both_precisions(real_windows, x64):
    assert len(real_windows) == 24
    with jax.enable_x64(x64):
        for positions, valid, expected in real_windows:
            released = expected["legacy_qtc"]
            released = np.where(released == 99, 0, released)  # the diagonal
            conventions = {"distance": expected["signed_qtc"], "as_published": released}
            for convention, expected_states in conventions.items():
                states = np.asarray(pairs(positions, convention))[np.ix_(valid, valid)]
                states[np.arange(valid.sum()), np.arange(valid.sum())] = 0
                np.testing.assert_array_equal(states, expected_states)


@pytest.mark.usefixtures("double")
@pytest.mark.parametrize(
    ("qsrlib", "calculus"), [("qtcbs", "b1"), ("qtccs", "c1"), ("qtcbcs", "bc1")]
)
def test_qsrlibs_own_cases(qsrlib, calculus):
    stored = json.loads((GOLDEN / "qsrlib.json").read_text())
    cases = [case for case in stored["cases"] if case["calculus"] == qsrlib]
    assert len(cases) == 14
    for case in cases:
        people = stored["recordings"][case["recording"]]
        k, l = (np.array(people[case[name]]) for name in "kl")
        factors = {"quantisation_factor": case["quantisation_factor"]}
        states = c1(k, l, "line", calculus, near=case["distance_threshold"], **factors)
        states = np.asarray(states) if case["no_collapse"] else collapse(states)
        states = validate(states) if case["validate"] else states
        assert [format_state(state, ",") for state in states] == case[
            "expected"
        ].split(), case


@pytest.mark.usefixtures("double")
def test_qsrlibs_argument_distance_and_moving_or_stationary():
    stored = json.loads((GOLDEN / "qsrlib.json").read_text())
    cases = [case for case in stored["cases"] if case["calculus"] in ("argd", "mos")]
    assert len(cases) == 7
    for case in cases:
        people = stored["recordings"][case["recording"]]
        k, l = (np.array(people[case[name]]) for name in "kl")
        if case["calculus"] == "mos":
            factors = {"quantisation_factor": case["quantisation_factor"]}
            states = c1(k, l, calculus="mos", **factors)
            letters = np.array(["s", "m"])[np.asarray(states)]
            texts = ["".join(row) for row in letters]
        else:
            # Its first state is that of the first positions, before any step.
            k, l = (np.concatenate([path[:1], path]) for path in (k, l))
            states = c1(k, l, calculus="argd", distances=tuple(case["distances"]))
            names = {-3: "close", -2: "near", -1: "far", 0: "veryfar"}
            texts = [names[symbol] for symbol in np.asarray(states)[:, 0].tolist()]
        assert texts == case["expected"].split(), case


@pytest.mark.slow
def test_argument_distance_has_rows_texts_a_diagram_and_inclusive_thresholds():
    k, l = np.zeros((5, 2)), np.array([[0, 0], [1, 0], [1.5, 0], [2, 0], [2.5, 0]])
    distances = (1.0, 2.0)
    states = np.asarray(observe(k, l, "argd", distances=distances))
    np.testing.assert_array_equal(states[:, 0], [-2, -1, -1, 0])
    np.testing.assert_array_equal(state_index("argd", states, distances), [0, 1, 1, 2])
    np.testing.assert_array_equal(all_states("argd", distances)[:, 0], [-2, -1, 0])
    assert state_texts("argd", distances) == ["<= 1 m", "<= 2 m", "> 2 m"]
    assert state_texts("mos") == ["s s", "s m", "m s", "m m"]
    # A distance passes through all between: neighbours are one apart.
    table = adjacency("argd")
    assert [list(np.flatnonzero(row)) for row in table] == [
        [1],
        [0, 2],
        [1, 3],
        [2, 4],
        [3],
    ]


@pytest.mark.parametrize("convention", CONVENTIONS)
@given(
    pair=GRID,
    turns=st.integers(0, 3),
    shift=st.tuples(*[st.integers(-99, 99)] * 2),
    angle=st.floats(0, 2 * math.pi),
)
def test_symmetries(convention, pair, turns, shift, angle):
    states = np.asarray(c1(*pair, convention))
    for calculus in literal.CALCULI:
        direct, swapped = (
            c1(*way, convention, calculus, near=9.0) for way in (pair, pair[::-1])
        )
        np.testing.assert_array_equal(swapped, literal.converse(direct))
    if convention != "as_published":  # Its sides have no sign.
        mirrored = c1(*(pair * np.array([1, -1], np.float32)), convention)
        np.testing.assert_array_equal(mirrored, states * np.array([[1, 1, -1, -1]]))
    # On a grid quarter turns and translations are exact.
    turn = np.linalg.matrix_power(np.array([[0, 1], [-1, 0]]), turns).astype(np.float32)
    moved = pair @ turn + np.array(shift, np.float32)
    np.testing.assert_array_equal(c1(*moved, convention), states)
    # All but exact ties is far from a tie, so any rotation changes ties only.
    turn = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    turned = c1(*(pair @ turn).astype(np.float32), convention)
    np.testing.assert_array_equal(jnp.where(states == 0, 0, turned), states)


def test_mirrored_distances_tie_even_where_a_compiler_fuses_a_product_and_a_sum():
    """3 4 and 4 3 are as long; a fused x * x + y * y rounds them differently."""
    draw = np.random.default_rng(0)
    start = draw.normal(size=(2000, 2))
    steps = np.stack([start, start[:, ::-1]], axis=1)
    assert not np.asarray(b1(steps, np.zeros((2000, 2, 2))))[..., 0].any()


def test_states_have_codes_rows_and_texts():
    assert int(encode_state(np.array([1, -1, -1, -1]))) == 54
    for calculus in (*literal.CALCULI, "argd", "mos"):
        rows = all_states(calculus)
        codes = jax.jit(state_index, static_argnums=0)(calculus, rows)
        np.testing.assert_array_equal(codes, range(len(rows)))
        with pytest.raises(
            ValueError, match="read-only"
        ):  # It is shared by all callers.
            rows[0, 0] = 1
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
    far = rows[:, 2] == ABSENT
    np.testing.assert_array_equal(table[np.ix_(far, far)], adjacency("b1"))
    np.testing.assert_array_equal(table[np.ix_(~far, ~far)], adjacency("c1"))
    for i, j in itertools.product(np.flatnonzero(far), np.flatnonzero(~far)):
        same = (rows[i, :2] == rows[j, :2]).all()
        assert table[i, j] == (same or literal.may_follow(rows[i, :2], rows[j, :2]))
    assert (len(rows), table.sum()) == (90, 2 * 929)


def test_alphas():
    rows = literal.states("c1")
    degrees = np.array([[15, 9, 11, 27, 80][state.count(0)] for state in rows])
    np.testing.assert_array_equal(alpha_table(), 1 / degrees)
    np.testing.assert_array_equal(alpha_table(include_self=True), 1 / (degrees + 1))
    shipped = [literal.shipped_alpha(state) for state in rows]
    np.testing.assert_array_equal(CndShipped().state_weights(), shipped)


def forecast(**change):
    arguments = {"samples": np.zeros((6, 4, 5, 2)), "observed": np.zeros((4, 3, 2))}
    return symbolic_forecast(**(arguments | change))


@pytest.mark.parametrize(
    ("call", "arguments", "message"),
    [
        (
            observe,
            [[[0, 0]], [[0, 0]], "c3"],
            "calculus must be one of b1, c1, bc1, argd, mos",
        ),
        (
            observe,
            {"k": [[0, 0]], "l": [[0, 0]], "convention": "lines"},
            "convention must be one",
        ),
        (
            observe,
            {"k": [[0, 0]], "l": [[0, 0]], "calculus": "argd", "distances": (2.0, 1.0)},
            "distances must be positive and increase",
        ),
        (forecast, {"calculus": "argd", "distances": (0.0,)}, "distances must be"),
        (adjacency, ["mos"], "mos has no published neighbourhood diagram"),
        (adjacency, ["c1", "any"], "rule must be one of dominance, continuity"),
        (
            make_weighting,
            ["cdn"],
            r"unknown weighting 'cdn': did you mean 'cnd'\? .*shuffled",
        ),
        (
            make_weighting,
            ["ones,learned=true"],
            "unknown field 'learned' for Ones: there are none",
        ),
        (
            make_weighting,
            ["soft,temprature=0.05"],
            "weighting: unknown field 'temprature'",
        ),
        (
            make_weighting,
            ["cnd,speed=-0.1"],
            "speed must be at least 0",
        ),
        (make_weighting, ["cnd,side_speed=NaN"], "_speed must be a finite"),
        (make_weighting, ["soft,temperature=0"], "temperature must be positive"),
        (
            make_weighting,
            ["cnd,convention=lines"],
            "convention must be one of distance, line, as",
        ),
        (make_weighting, ["quantised,speed=0,learned=true"], "cannot be learned"),
        (
            forecast,
            {"calculus": "z9"},
            "calculus must be one of b1, c1, bc1, argd, mos",
        ),
        (forecast, {"speed": -1.0}, "speed must"),
        (forecast, {"sped": 1.0}, "unknown field 'sped'"),
        (forecast, {"pairs": [[0, 9]]}, "pairs must name people by 0 to 3"),
        (
            forecast,
            {"observed": np.zeros((2, 3, 2))},
            r"not \[6, 4, 5, 2\] and \[2, 3, 2\]",
        ),
    ],
)
def test_refusals(call, arguments, message):
    with pytest.raises(InputError, match=message):
        call(**arguments) if isinstance(arguments, dict) else call(*arguments)


def test_positions_of_lists_are_read_and_of_other_shapes_refused():
    way, other = np.cumsum(np.full((9, 2), 0.3), axis=0), np.zeros((9, 2))
    symbols = observe(way.tolist(), other.tolist())
    np.testing.assert_array_equal(symbols, c1(way, other))
    for wrong in (other[:8], np.zeros((9, 3))):
        with pytest.raises(InputError, match=r"\[\.\.\., T, 2\] of one length"):
            observe(way, wrong)
    with pytest.raises(InputError, match="quantisation_factor"):
        observe(way, other, quantisation_factor=-0.1)
