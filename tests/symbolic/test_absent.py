"""A position that is not there: absent states, no weight, gradients of 0, and no other effect."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from neurosym_jax.symbolic.events import EVENTS, Event, register_event
from neurosym_jax.symbolic.forecast import (
    SymbolSettings,
    forecast_rows,
    format_pairs,
    symbolic_events,
    symbolic_forecast,
)
from neurosym_jax.symbolic.qtc import (
    ABSENT,
    all_states,
    encode_state,
    observe,
    state_index,
)
from neurosym_jax.symbolic.soft import soft_alpha, soft_symbols
from neurosym_jax.symbolic.weighting import WEIGHTINGS, Learned, make_weighting
from tests.symbolic import literal

GAP, STEPS = 3, 7
# One program each, and not one for each operation.
observe = jax.jit(observe, static_argnames=("calculus", "convention"))
state_index = jax.jit(state_index, static_argnames="calculus")


@pytest.fixture(autouse=True)
def strict():
    """NaN is what these tests are about."""
    with jax.numpy_rank_promotion("raise"), jax.debug_nans(False):
        yield


@pytest.fixture
def walks():
    """Four people [4, 8, 2], and the same with one coordinate of the second missing at a time."""
    complete = np.random.default_rng(0).normal(0, 0.3, (4, STEPS + 1, 2)).cumsum(axis=1)
    gappy = complete.copy()
    gappy[1, GAP, 0] = np.nan
    return complete, gappy


def pairs_of_the_second(steps=STEPS):
    """[4, 4, T] bool: pairs with the second person, at the steps that touch the gap."""
    second = np.arange(4) == 1
    touched = np.isin(np.arange(steps), np.array([GAP - 1, GAP]) + steps - STEPS)
    return (second[:, None] | second)[..., None] & touched


@pytest.mark.parametrize("convention", literal.CONVENTIONS)
@pytest.mark.parametrize("calculus", [*literal.CALCULI, "argd", "mos"])
def test_a_state_is_absent_at_both_steps_of_a_gap_and_no_other_changes(
    walks, calculus, convention
):
    complete, gappy = (
        observe(x[:, None], x, calculus, convention=convention) for x in walks
    )
    absent = pairs_of_the_second()
    assert (np.asarray(gappy)[absent] == ABSENT).all()
    np.testing.assert_array_equal(gappy[~absent], complete[~absent])
    rows = np.asarray(state_index(calculus, gappy))
    assert (rows[absent] == len(all_states(calculus))).all()
    assert rows[~absent].max() < len(all_states(calculus))


@pytest.mark.slow
@pytest.mark.parametrize("straight_through", [False, True])
def test_soft_symbols_have_no_probability_and_gradients_of_zero(
    walks, straight_through
):
    options = {"temperature": 0.05, "quantisation_factor": 0.02}
    options["straight_through"] = straight_through
    table = np.random.default_rng(1).normal(size=81)

    def total(positions, temperature=0.05):
        arguments = options | {"temperature": temperature}
        probabilities = soft_symbols(positions[:, None], positions, **arguments)
        return (soft_alpha(probabilities) + soft_alpha(probabilities, table)).sum()

    complete, gappy = (
        np.asarray(soft_symbols(x[:, None], x, **options)) for x in walks
    )
    absent = pairs_of_the_second()
    assert not gappy[absent].any()
    assert not np.asarray(soft_alpha(gappy))[absent].any()
    np.testing.assert_array_equal(gappy[~absent], complete[~absent])
    gradient, temperature_gradient = jax.grad(total, argnums=(0, 1))(
        jnp.asarray(walks[1]), 0.05
    )
    assert np.isfinite(gradient).all()
    assert not np.asarray(gradient[1, GAP]).any()
    assert np.asarray(gradient[1, GAP + 1]).any()
    assert np.isfinite(temperature_gradient)


@pytest.mark.parametrize(
    "text", [*WEIGHTINGS, "soft,learned=true", "quantised,learned=true"]
)
def test_alpha_is_zero_there_and_nobody_elses_changes(walks, text):
    weigh = jax.jit(make_weighting(text))
    complete, gappy = (np.asarray(weigh(positions)) for positions in walks)
    absent = pairs_of_the_second(STEPS + 1)
    assert not gappy[absent].any()
    if text != "shuffled":  # It gives a pair the weights of another one.
        np.testing.assert_array_equal(gappy[~absent], complete[~absent])
    total = jax.jit(jax.grad(lambda positions: weigh(positions).sum()))
    gradient = total(jnp.asarray(walks[1]))
    assert np.isfinite(gradient).all()
    assert not np.asarray(gradient[1, GAP]).any()


def test_a_table_learns_nothing_from_what_is_absent(walks):
    weighting, positions = Learned(), jnp.asarray(walks[1])
    initial = {name: jnp.asarray(value) for name, value in weighting.start().items()}
    total = jax.jit(jax.grad(lambda learned: weighting.alpha(learned, positions).sum()))
    pairs = ~np.eye(4, dtype=bool)[..., None] & ~pairs_of_the_second()
    codes = np.asarray(encode_state(observe(positions[:, None], positions)))[pairs]
    np.testing.assert_array_equal(
        total(initial)["table"], np.bincount(codes, minlength=81)
    )


def test_forecasts_of_symbols_and_events_are_of_the_samples_that_have_a_state():
    """k meets l, who stands 5 m ahead; l is gone in two of four samples, and m in all."""
    t = 0.4 * np.arange(1, 13)[:, None]
    k, l, m = t * [1, 0], 0 * t + [5, 0], 0 * t + [0, 9]
    samples = np.stack([np.stack([k, l, m])] * 4)
    samples[:2, 1], samples[:, 2] = np.nan, np.nan
    observed = np.array([[[0.0, 0]], [[5, 0]], [[0, 9]]])
    settings = {"smoothing": 1.0, "calculus": "b1"}
    shares = np.asarray(symbolic_forecast(samples, observed, **settings))
    towards = list(map(tuple, all_states("b1"))).index((-1, 0))
    np.testing.assert_allclose(
        shares[0, 1, 0, towards], (2 + 1 / 9) / (2 + 1), rtol=1e-6
    )
    assert not shares[2].any()
    assert not shares[:, 2].any()
    events = symbolic_events(samples, observed)
    meets = list(EVENTS).index("meets")
    np.testing.assert_allclose(
        events.probability[meets, 0, 1], (2 + 0.5) / 3, rtol=1e-6
    )
    np.testing.assert_allclose(events.seconds[meets, 0, 1], 4.0, rtol=1e-6)
    assert not np.asarray(events.probability[:, 0, 2]).any()
    rows = forecast_rows(samples, observed, np.arange(3), SymbolSettings())
    gone = next(row for row in rows if (row["k"], row["l"]) == (0, 2))
    assert {step["state"] for step in gone["states"]} == {None}


def test_no_event_happens_without_a_state_and_a_gap_ends_what_lasts():
    walk = np.zeros((2, 25, 2))
    walk[0, :, 0], walk[1, :, 0] = 0.3 * np.arange(25), 30
    gappy = walk.copy()
    gappy[0, 8] = np.nan
    register_event("anything", Event("always", lambda e: e.distance[..., 1:] != -1))

    def seconds(walk, name):
        samples, observed = walk[None, :, 1:], walk[:, :1]
        events = symbolic_events(
            samples, observed, events=(name,), period=0.1, smoothing=0.0
        )
        return float(events.seconds[0, 0, 1, 1])

    # Approaching for 1.2 s: 12 steps from the start, and from the end of the gap's
    # second step.
    assert seconds(walk, "approaches") == pytest.approx(1.2)
    assert seconds(gappy, "approaches") == pytest.approx(0.9 + 1.2)
    assert seconds(gappy[:, 7:], "anything") == pytest.approx(0.3)


def test_an_absent_state_is_blank_in_a_table():
    codes = np.full((2, 2, 3), 81)
    codes[0, 1, 0] = 0
    line = format_pairs(codes, np.array([7, 3]), 0.4).splitlines()[1]
    assert line.split() == ["(7,", "3)", "----", "."]
