import functools

import jax
import numpy as np
import pytest

from neurosym_jax.symbolic.qtc import alpha_table, encode_state, observe
from neurosym_jax.symbolic.soft import soft_alpha, soft_symbols
from tests.symbolic import literal

pytestmark = pytest.mark.usefixtures("double")

CONVENTIONS = literal.CONVENTIONS


@functools.partial(jax.jit, static_argnames=("convention", "straight_through"))
def soft(k, l, temperature, factor=0.0, convention="distance", straight_through=False):
    return soft_symbols(
        k,
        l,
        temperature=temperature,
        quantisation_factor=factor,
        convention=convention,
        side_quantisation_factor=factor,
        straight_through=straight_through,
    )


@functools.partial(jax.jit, static_argnames="convention")
def hard(k, l, factor=0.0, convention="distance"):
    return observe(
        k,
        l,
        quantisation_factor=factor,
        convention=convention,
        side_quantisation_factor=factor,
    )


def chains():
    """(k, l [..., T, 2], convention, quantisation factor), with and without ties."""
    draw = np.random.default_rng(0)
    anywhere = draw.normal(0, 0.3, (2, 300, 8, 2)).cumsum(axis=2)
    for k, l in (literal.unit_steps(), literal.grid_walks(400), anywhere):
        for convention in CONVENTIONS:
            for factor in (0.0, 0.05):
                yield np.array(k), np.array(l), convention, factor


@pytest.mark.slow
def test_hard_symbols_wherever_the_margin_exceeds_ten_temperatures():
    temperature = 1e-6
    compared = ties = 0
    for k, l, convention, factor in chains():
        probabilities = np.asarray(soft(k, l, temperature, factor, convention))
        np.testing.assert_allclose(probabilities.sum(axis=-1), 1, atol=1e-12)
        states = np.asarray(hard(k, l, factor, convention))
        margin = np.array([literal.margins(*pair, convention) for pair in zip(k, l)])
        distance = np.linalg.norm(l - k, axis=-1)[:, :-1, None]
        decided = abs(abs(margin) - factor) > 10 * temperature
        decided[..., 2:] &= distance > temperature
        certain = np.take_along_axis(probabilities, (states + 1)[..., None], axis=-1)[
            ..., 0
        ]
        assert (certain[decided] > 0.9999).all()
        tied = (margin == 0) & (factor > 0)
        assert (probabilities[..., 1][tied] == 1).all()
        compared, ties = compared + decided.sum(), ties + tied.sum()
    assert compared > 30_000
    assert ties > 5_000


def test_probabilities_fade_over_a_temperature_and_ties_are_half_and_half():
    """k steps 6, 5 and 4 cm towards l at a threshold of 5: the half-way points are logistic."""
    l = np.array([[4.0, 0], [4, 0]])
    for step, odds in ((0.06, 1), (0.05, 0), (0.04, -1)):
        towards = soft(np.array([[0.0, 0], [step, 0]]), l, 0.01, 0.05)[0, 0]
        np.testing.assert_allclose(towards[0], 1 / (1 + np.exp(-odds)), rtol=1e-9)
        np.testing.assert_allclose(towards[2], 1 / (1 + np.exp(10 + odds)), rtol=1e-9)
    np.testing.assert_allclose(
        soft(np.array([[0.0, 0], [0, 1]]), l, 0.01)[0, 3], [0.5, 0, 0.5]
    )
    stands = soft(l, l, 0.01, 0.05)[0]  # Two people on one spot.
    np.testing.assert_allclose(stands[:, 1], np.tanh(0.05 / 0.01 / 2))


@pytest.mark.slow
def test_straight_through_is_hard_with_soft_gradients():
    k, l = random_pairs(200)
    options = {"temperature": 0.05, "factor": 0.1, "convention": "as_published"}
    through = soft(k, l, **options, straight_through=True)
    states = np.asarray(hard(k, l, 0.1, "as_published"))
    np.testing.assert_array_equal(through, np.eye(3)[states + 1])
    weights = np.random.default_rng(1).normal(size=(4, 3))

    def total(k, factor, **kind):
        return (
            soft(k, l, **options | kind | {"factor": factor}) * weights[None, None]
        ).sum()

    gradient = jax.grad(total, argnums=(0, 1))
    for through_gradient, soft_gradient in zip(
        gradient(k, 0.1, straight_through=True), gradient(k, 0.1)
    ):
        np.testing.assert_allclose(through_gradient, soft_gradient, rtol=1e-9)


@pytest.mark.parametrize("convention", CONVENTIONS)
def test_paths_have_any_leading_axes(convention):
    paths = np.random.default_rng(5).normal(size=(2, 3, 5, 4, 2))
    probabilities = soft(*paths, 0.05, convention=convention)
    flat = soft(*paths.reshape(2, 15, 4, 2), 0.05, convention=convention)
    np.testing.assert_array_equal(probabilities, flat.reshape(3, 5, 3, 4, 3))


@pytest.mark.slow
def test_expected_weights_are_sums_over_all_states():
    draw = np.random.default_rng(0).dirichlet([0.5] * 3, (50, 4))
    states = np.indices((3,) * 4).reshape(4, 81)
    joint = np.prod([draw[:, q, states[q]] for q in range(4)], axis=0)
    np.testing.assert_allclose(soft_alpha(draw), joint @ alpha_table(), rtol=1e-12)
    table = np.random.default_rng(1).normal(size=81)
    np.testing.assert_allclose(soft_alpha(draw, table), joint @ table, rtol=1e-12)
    # For certain symbols what the table says, exactly.
    states = np.random.default_rng(0).integers(-1, 2, (40, 4))
    certain = soft_alpha(np.eye(3)[states + 1], table)
    np.testing.assert_array_equal(certain, table[encode_state(states)])


def random_pairs(count, seed=0):
    """Steps of two people [count, 2, 2]: a tenth of each kind of degeneracy, the rest at random."""
    draw = np.random.default_rng(seed)
    start, step = (
        draw.uniform(-2, 2, (2, count, 1, 2)),
        draw.normal(0, 0.3, (2, count, 2, 2)),
    )
    k, l = start + step
    kind = np.arange(count) % 10
    k[kind == 1, 1] = k[kind == 1, 0]  # k stands.
    k[kind == 2], l[kind == 2] = k[kind == 2][:, :1], l[kind == 2][:, :1]  # Both stand,
    l[kind == 3, 0] = k[kind == 3, 0]  # start on one spot,
    l[kind == 4] = k[kind == 4]  # are one and the same,
    l[kind == 5, 0] = k[kind == 5, 1]  # k steps onto l,
    k[kind == 6] = l[kind == 6] = 0  # all are at the origin.
    k[kind == 7, :, 1] = l[kind == 7, :, 1] = 1  # All on one line.
    k[kind == 8, 1] = k[kind == 8, 0] + [1e-9, 0]  # Hardly a step.
    return k, l


@pytest.mark.parametrize("convention", ["distance", "line"])
def test_gradients_are_finite_differences(convention):
    """Derivatives of alpha by all coordinates, the temperature and the threshold, 10,000 pairs."""
    pairs = np.stack(random_pairs(10_000), axis=1).reshape(-1, 8)
    settings = np.broadcast_to([0.1, 0.15], (len(pairs), 2))
    inputs = np.concatenate([pairs, settings], axis=1)
    table = np.random.default_rng(2).normal(size=81)

    def alpha(inputs):
        k, l = inputs[:8].reshape(2, 2, 2)
        return soft_alpha(soft(k, l, inputs[8], inputs[9], convention), table)[0]

    gradient = np.asarray(jax.jit(jax.vmap(jax.grad(alpha)))(inputs))
    assert np.isfinite(gradient).all()
    small, values = 1e-7, jax.jit(jax.vmap(alpha))
    for axis in range(10):
        step = small * np.eye(10)[axis][None]
        difference = np.asarray(values(inputs + step) - values(inputs - step)) / (
            2 * small
        )
        np.testing.assert_allclose(gradient[:, axis], difference, rtol=1e-5, atol=1e-6)
    assert (abs(gradient).max(axis=0) > 0.1).all()
