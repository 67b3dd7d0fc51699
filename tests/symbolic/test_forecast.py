"""Probabilities of states, symbols and events against counts by hand."""

import functools
import re

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from neurosym_jax.errors import InputError
from neurosym_jax.symbolic.events import Event, register_event
from neurosym_jax.symbolic.forecast import (
    SymbolSettings,
    forecast_rows,
    format_forecast,
    format_pairs,
    symbolic_events,
    symbolic_forecast,
)
from neurosym_jax.symbolic.qtc import all_states, observe, state_texts

STEP, OBSERVED = 0.4, 3


@functools.partial(jax.jit, static_argnames="calculus")
def observe_pairs(path, calculus, **options):
    return observe(path[:, None], path, calculus, **options)


@pytest.fixture(scope="module")
def crowd():
    """(samples [6, 4, 5, 2], observed [4, 3, 2]): wandering people."""
    draw = np.random.default_rng(3)
    observed = draw.uniform(0, 5, (4, 1, 2)) + draw.normal(
        0, 0.3, (4, OBSERVED, 2)
    ).cumsum(axis=1)
    samples = observed[:, -1:] + draw.normal(0, 0.3, (6, 4, 5, 2)).cumsum(axis=2)
    return samples, observed


@pytest.mark.parametrize("calculus", ["b1", "c1", "bc1"])
def test_probabilities_are_smoothed_shares_of_the_samples(crowd, calculus):
    samples, observed = crowd
    shares = symbolic_forecast(samples, observed, calculus=calculus, smoothing=2.0)
    table = all_states(calculus)
    expected = np.zeros((4, 4, 5, len(table)))
    for sample in samples:
        path = np.concatenate([observed[:, -1:], sample], axis=1)
        thresholds = {"quantisation_factor": 0.05, "side_quantisation_factor": 0.05}
        seen = np.asarray(observe_pairs(path, calculus, **thresholds))
        expected += (seen[..., None, :] == table).all(axis=-1)
    expected = (expected + 2 / len(table)) / (len(samples) + 2)
    expected[np.arange(4), np.arange(4)] = 0
    np.testing.assert_allclose(shares, expected, atol=1e-6)


@pytest.mark.slow
def test_pairs_origin_and_compilation_change_nothing(crowd):
    samples, observed = crowd
    all_shares = symbolic_forecast(samples, observed)
    events = symbolic_events(samples, observed)
    k, l = pairs = np.array([[2, 1], [0, 3]])
    pair_shares = symbolic_forecast(samples, observed, pairs=pairs.T)
    np.testing.assert_allclose(pair_shares, all_shares[k, l], atol=1e-6)
    pair_events = symbolic_events(samples, observed, pairs=pairs.T)
    np.testing.assert_allclose(
        pair_events.probability, events.probability[:, k, l], atol=1e-6
    )
    far = np.array([4.5e6, -3e6])
    for same in (
        symbolic_forecast(samples + far, observed + far),
        jax.jit(symbolic_forecast)(*map(jnp.asarray, crowd)),
    ):
        np.testing.assert_allclose(same, all_shares, atol=1e-6)


def test_a_threshold_in_metres_per_second_holds_at_every_period():
    walk = np.zeros((1, 2, 40, 2))
    # 0.3 m/s at 10 Hz, towards a person 9 m off.
    walk[0, 0, :, 0] = 0.3 * 0.1 * np.arange(1, 41)
    walk[0, 1, :, 0] = 9
    observed = np.array([[[0.0, 0]], [[9, 0]]])
    for speed, towards in ((0.25, 1.0), (0.35, 0.0)):
        for stride in (1, 4):
            slower = walk[:, :, stride - 1 :: stride]
            settings = {"period": 0.1 * stride, "speed": speed, "smoothing": 0.0}
            states = symbolic_forecast(slower, observed, calculus="b1", **settings)[
                0, 1
            ]
            np.testing.assert_allclose(states[:, :3].sum(axis=-1), towards, atol=1e-6)


def both(k, l, steps=8):
    """Samples [1, 2, T, 2] and observed [2, 1, 2] of two people that walk straight, m and m/s."""
    t = STEP * np.arange(steps + 1)[:, None]
    paths = np.stack([np.array(at) + t * np.array(speed) for at, speed in (k, l)])
    return paths[None, :, 1:], paths[:, :1]


CASES = {
    # An event (k, l), and the seconds at which it happens: at the end of the first step
    # on which the new symbol exceeds its threshold.
    "approaches": ((((0, 0), (1, 0)), ((9, 0), (0, 0))), 1.2),
    "passes_left": ((((0, 0), (1, 0)), ((1.5, 1), (0, 0))), 2.0),
    "passes_right": ((((0, 0), (1, 0)), ((4.1, -1), (-1, 0))), 2.8),
    "crosses_before": ((((-1.5, 0), (1, 0)), ((0, -4), (0, 1))), 1.6),
    "crosses_behind": ((((-1.5, 0), (1, 0)), ((0, 0.5), (0, 1))), 1.6),
    "follows": ((((0, 0), (1, 0)), ((2, 0.2), (1, 0))), 1.2),
    "overtakes": ((((0, 0), (1.5, 0)), ((0.6, 0.8), (0.8, 0))), 2.0),
    "meets": ((((0, 0), (1, 0)), ((5, 0), (-1, 0))), 2.0),
}


@pytest.mark.parametrize("name", CASES)
def test_an_event_happens_when_it_should_and_not_in_the_mirror(name):
    ways, seconds = CASES[name]
    forecast = symbolic_events(*both(*ways), events=(name,), smoothing=0.0)
    assert float(forecast.probability[0, 0, 1]) == 1
    np.testing.assert_allclose(forecast.seconds[0, 0, 1], seconds, atol=1e-5)
    if name in ("follows", "overtakes"):  # Not the other way round.
        assert float(forecast.probability[0, 1, 0]) == 0
    mirrored = np.array(ways) * [1, -1]
    sides = {"passes_left": "passes_right", "passes_right": "passes_left"}
    other = sides.get(name, name)
    again = symbolic_events(*both(*mirrored), events=(other,), smoothing=0.0)
    np.testing.assert_allclose(again.seconds[0, 0, 1], seconds, atol=1e-5)


ALMOST = [
    ("passes_left", ((0, 0), (1, 0)), ((1.5, 0), (0, 0))),  # Neither left nor right.
    ("passes_right", ((0, 0), (1, 0)), ((1.5, 0), (0, 0))),
    ("crosses_before", ((1, -0.3), (0.94, 0.34)), ((0, 0), (1, 0))),  # At 20 degrees.
    ("follows", ((0, 0), (1, 0)), ((2, 0.2), (0.5, 0.87))),  # 60 degrees apart.
    (
        "follows",
        ((0, 0), (1, 0)),
        ((2, 0.2), (0.1, 0)),
    ),  # Slower than 0.125 m/s: stands.
]


@pytest.mark.parametrize(("name", "k", "l"), ALMOST)
def test_an_event_does_not_happen_where_a_condition_is_just_missed(name, k, l):
    assert (
        float(
            symbolic_events(
                *both(k, l), events=(name,), smoothing=0.0
            ).probability.max()
        )
        == 0
    )


@pytest.mark.parametrize(
    ("degrees", "crosses"), [(29.5, 0), (30.5, 1), (149.5, 1), (150.5, 0)]
)
def test_ways_cross_at_30_to_150_degrees(degrees, crosses):
    """They meet at the origin after 3.5 steps; l goes along x, k a little later."""
    way = np.array([np.cos(np.radians(degrees)), np.sin(np.radians(degrees))])
    paths = both((-1.5 * way, way), ((-1.4, 0), (1, 0)))
    forecast = symbolic_events(
        *paths, events=("crosses_before", "crosses_behind"), smoothing=0.0
    )
    assert float(forecast.probability[:, 0, 1].max()) == crosses


def test_tables_of_pairs(crowd):
    people = np.array([7, 3, 9, 5])
    rows = forecast_rows(*crowd, people, SymbolSettings())
    shares = []
    for row in rows:
        shares.append([event["probability"] for event in row["events"].values()])
    largest = [max(row_shares) for row_shares in shares]
    assert largest == sorted(largest, reverse=True)
    pair_shares = {
        (row["k"], row["l"]): row_shares for row, row_shares in zip(rows, shares)
    }
    events = symbolic_events(*crowd)
    np.testing.assert_allclose(
        pair_shares[9, 3], events.probability[:, 2, 1], atol=5.1e-5
    )
    pair = next(row for row in rows if (row["k"], row["l"]) == (9, 3))
    for event, times in zip(
        pair["events"].values(), np.asarray(events.seconds[:, 2, 1])
    ):
        assert (event["seconds"] is None) == np.isinf(times[0])
    lines = format_forecast(rows, at_least=0.0).splitlines()[1:]
    told = [float(re.findall(r" ([01]\.\d\d)  ", line)[-1]) for line in lines]
    assert told == sorted(told, reverse=True)
    assert len(told) == sum(map(len, shares))
    assert rows[0]["states"][0]["probability"] == round(
        rows[0]["states"][0]["probability"], 4
    )
    codes = np.zeros((2, 2, 3), int)
    codes[0, 1] = [1, 1, 2]
    lines = format_pairs(codes, people[:2], 0.4).splitlines()
    texts = state_texts()
    assert [line.split() for line in lines] == [
        ["pair", "(k,", "l)", "s", "0.4", "0.8", "1.2"],
        ["(7,", "3)", texts[1], ".", texts[2]],
    ]

    names = np.array(["Müller, José", "O'Brien", "Al"])
    lines = format_pairs(np.ones((3, 3, 3), int), names, 0.4).splitlines()
    assert lines[1].startswith("(Müller, José, O'Brien) ")
    # Under the end of each time stands the end of its cell, whatever the names are.
    assert {len(line) for line in lines} == {len(lines[0])}
    assert {line.index(texts[1]) for line in lines[1:]} == {lines[0].index("0.4") - 1}


def test_events_that_do_not_happen_have_no_time():
    parting, together = (
        (((0, 0), (-1, 0)), ((5, 0), (1, 0))),
        (((0, 0), (1, 0)), ((0, 1), (1, 0))),
    )
    for ways in (parting, together):
        forecast = symbolic_events(*both(*ways), events=tuple(CASES))
        np.testing.assert_allclose(
            forecast.probability[:, 0, 1], 0.25
        )  # (0 + 1/2) / (1 + 1)
        assert np.isinf(forecast.seconds[:, 0, 1]).all()


def test_times_are_the_quartiles_over_the_samples_in_which_it_happens():
    starts = [2.0, 2.4, 2.8, 3.2, 3.6, 4.0, 4.4, 4.8, 9.0]
    parts = [both(((0, 0), (0, 0)), ((x + 0.1, 0), (-1, 0)), steps=12) for x in starts]
    samples, observed = (
        np.concatenate([p[0] for p in parts]),
        np.array([[[0.0, 0]], [[9, 0]]]),
    )
    forecast = symbolic_events(samples, observed, events=("meets",))
    np.testing.assert_allclose(forecast.probability[0, 0, 1], (8 + 0.5) / 10)
    np.testing.assert_allclose(
        forecast.seconds[0, 0, 1], [0.4 * 4, 0.4 * 6, 0.4 * 8], atol=1e-5
    )


def test_a_registered_event_is_forecast_like_the_others():
    name, standing = "stands_near", both(((0, 0), (0, 0)), ((0.5, 0), (0, 0)))
    register_event(
        name, Event("both stand", lambda e: (e.states == 0).all(axis=-1) & e.within(1))
    )
    assert (
        float(symbolic_events(*standing, events=(name,)).probability[0, 0, 1]) == 0.75
    )
    register_event("wrong", Event("gives no steps", lambda e: e.distance < 1))
    with pytest.raises(InputError, match=r"event wrong: bool \[..., 8\] is wanted"):
        symbolic_events(*standing)
