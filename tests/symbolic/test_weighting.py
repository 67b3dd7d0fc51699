import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from neurosym_jax.errors import InputError
from neurosym_jax.symbolic.cnd import alpha_table
from neurosym_jax.symbolic.qtc import pairwise_qtc_c1
from neurosym_jax.symbolic.states import encode_state
from neurosym_jax.symbolic.weighting import (
    Weighting,
    alpha_from_states,
    named_weighting,
    pair_alpha,
)

NAMES = ("cnd", "cnd_shipped", "ones", "zeros")


@functools.partial(jax.jit, static_argnames="weighting")
def alpha_of(positions, valid=None, weighting="cnd"):
    return pair_alpha(positions, valid, weighting=weighting)


@jax.jit
def codes_of(positions):
    return encode_state(pairwise_qtc_c1(positions))


def walks(agents, seed=0, steps=8):
    return np.random.default_rng(seed).integers(-9, 10, (agents, steps, 2)).astype(np.float32)


def test_shipped_weights_of_real_windows(real_windows):
    shipped = named_weighting("cnd_shipped", decimals=4)
    weigh = jax.jit(functools.partial(pair_alpha, weighting=shipped, convention="as_published"))
    for positions, valid, expected in real_windows:
        alpha = np.asarray(weigh(positions, valid))[np.ix_(valid, valid)]
        np.testing.assert_array_equal(alpha, expected["alpha_shipped"])


@pytest.mark.usefixtures("double")
def test_shipped_weights_of_the_released_code(golden):
    case = np.load(golden / "torch" / "qtc.npz")
    pairs = np.stack([case["k"], case["l"]], axis=1)
    shipped = named_weighting("cnd_shipped", decimals=4)
    weigh = functools.partial(pair_alpha, weighting=shipped, convention="as_published")
    alpha = jax.jit(jax.vmap(weigh))(pairs)
    assert alpha.dtype == jnp.float64
    np.testing.assert_array_equal(alpha[:, 0, 1, 1:], case["alpha_reference"])


def test_shipped_tables_are_the_authors(golden):
    reference = np.load(golden / "qtc" / "cnd.npz")
    np.testing.assert_array_equal(
        named_weighting("cnd_shipped", decimals=4).table, reference["C1_alpha_neurosym"]
    )
    np.testing.assert_array_equal(
        named_weighting("cnd_shipped").table, reference["C1_alpha_neurosym_exact"]
    )


def test_the_state_up_to_a_step_weights_that_step():
    positions = walks(4)
    alpha = np.asarray(alpha_of(positions))
    table = alpha_table().astype(np.float32)
    expected = jax.jit(lambda positions: alpha_from_states(pairwise_qtc_c1(positions), table))(
        positions
    )
    i, j = np.nonzero(~np.eye(4, dtype=bool))
    np.testing.assert_array_equal(alpha[i, j, 0], 0)
    np.testing.assert_array_equal(alpha[i, j, 1:], np.asarray(expected)[i, j])
    np.testing.assert_array_equal(alpha[np.arange(4), np.arange(4)], 1)


def test_ones_and_zeros():
    valid = np.array([True, False, True])
    pairs = np.outer(valid, valid)[..., None] * np.ones(8)
    np.testing.assert_array_equal(alpha_of(walks(3), valid, "ones"), pairs)
    own = np.diag(valid)[..., None] * np.ones(8)
    np.testing.assert_array_equal(alpha_of(walks(3), valid, "zeros"), own)


@pytest.mark.parametrize("weighting", NAMES)
@pytest.mark.parametrize("slots", [1, 2, 5])
def test_whoever_is_alone_weighs_nothing(weighting, slots):
    valid = np.arange(slots) == slots - 1
    assert not np.asarray(alpha_of(walks(slots), valid, weighting)).any()
    if slots == 1:
        assert not np.asarray(alpha_of(walks(1), weighting=weighting)).any()


@pytest.mark.parametrize("weighting", NAMES)
@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), agents=st.sampled_from([1, 2, 5, 9]))
def test_neither_padding_nor_order_changes_a_weight(weighting, seed, agents):
    positions, draw = walks(9, seed), np.random.default_rng(seed)
    slots = draw.permutation(9)[:agents]
    valid = np.isin(np.arange(9), slots)
    padded = np.asarray(alpha_of(positions, valid, weighting))
    alone = np.asarray(alpha_of(positions[slots], weighting=weighting))
    np.testing.assert_array_equal(padded[np.ix_(slots, slots)], alone)
    assert not padded[~valid].any()
    assert not padded[:, ~valid].any()


def test_one_step_has_no_state_yet():
    np.testing.assert_array_equal(alpha_of(walks(2, steps=1))[..., 0], np.eye(2))


def test_scenes_are_mapped():
    batch = np.stack([walks(4, seed) for seed in range(3)])
    valid = np.arange(4)[None] < np.array([[4], [1], [2]])
    mapped = jax.jit(jax.vmap(pair_alpha))(batch, valid)
    for scene in range(3):
        np.testing.assert_array_equal(mapped[scene], alpha_of(batch[scene], valid[scene]))


def test_a_table_can_be_learnt():
    positions, weighting = walks(3), Weighting(jnp.full(81, 0.1), jnp.array(0.5))
    total = jax.jit(jax.grad(lambda weighting: pair_alpha(positions, weighting=weighting).sum()))
    gradient = total(weighting)
    assert float(gradient.unobserved) == 6  # ordered pairs
    others = ~np.eye(3, dtype=bool)
    codes = np.asarray(codes_of(positions))[others]
    np.testing.assert_array_equal(gradient.table, np.bincount(codes.ravel(), minlength=81))


def test_integer_positions_give_real_weights():
    alpha = alpha_of(walks(3).astype(np.int32))
    np.testing.assert_array_equal(alpha, alpha_of(walks(3)))
    assert alpha.dtype == jnp.float32


def test_an_unknown_weighting_is_refused():
    with pytest.raises(InputError, match=r"'cdn'.*cnd, cnd_shipped, ones, zeros"):
        pair_alpha(walks(2), weighting="cdn")  # pyright: ignore
