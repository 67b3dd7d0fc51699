import dataclasses
import functools
import pickle

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from neurosym_jax.configuration import Positive, component
from neurosym_jax.errors import InputError
from neurosym_jax.symbolic.qtc import alpha_table, encode_state, observe
from neurosym_jax.symbolic.weighting import (
    WEIGHTINGS,
    Cnd,
    CndShipped,
    Learned,
    Soft,
    Weighting,
    initial_parameters,
    is_constant,
    make_weighting,
    register_weighting,
)

NAMES = tuple(WEIGHTINGS)
RELEASED = CndShipped(convention="as_published", decimals=4)


def from_text(text):
    return component(text, WEIGHTINGS, "weighting")


@functools.cache
def compiled(weighting):
    return jax.jit(make_weighting(weighting))


def alpha_of(positions, valid=None, weighting="cnd"):
    valid = np.ones(len(positions), bool) if valid is None else valid
    return compiled(weighting)(positions, valid)


def walks(agents, seed=0, steps=8):
    return (
        np.random.default_rng(seed)
        .integers(-9, 10, (agents, steps, 2))
        .astype(np.float32)
    )


def test_shipped_table_and_weights_of_real_windows(shared, real_windows):
    authors = np.load(shared / "golden" / "qtc" / "cnd.npz")["C1_alpha_neurosym"]
    np.testing.assert_array_equal(RELEASED.state_weights(), authors)
    weigh = jax.jit(make_weighting(RELEASED))
    for positions, valid, expected in real_windows:
        alpha = np.asarray(weigh(positions, valid))[np.ix_(valid, valid)]
        np.testing.assert_array_equal(alpha, expected["alpha_shipped"])


def test_the_state_up_to_a_step_weights_that_step():
    positions = walks(4)
    alpha = np.asarray(alpha_of(positions))
    table = alpha_table().astype(np.float32)
    expected = table[encode_state(observe(positions[:, None], positions))]
    expected = np.pad(expected, [(0, 0), (0, 0), (1, 0)])
    np.testing.assert_array_equal(
        alpha, np.where(np.eye(4, dtype=bool)[..., None], 1, expected)
    )


def test_ones_and_zeros():
    valid = np.array([True, False, True])
    for name, pairs in (("ones", np.outer(valid, valid)), ("zeros", np.diag(valid))):
        expected = pairs[..., None] * np.ones(8)
        np.testing.assert_array_equal(alpha_of(walks(3), valid, name), expected)


def test_what_is_constant():
    alpha = np.ones((3, 3, 4))
    alpha[..., 0], alpha[[0, 1, 2], [0, 1, 2]] = 0.5, 2
    assert is_constant(alpha)
    alpha[0, 2, 3] = 0.9
    assert not is_constant(alpha)
    assert not is_constant(alpha[:1, :1])


def test_quantised_symbols_are_zero_up_to_five_centimetres():
    positions = np.zeros((2, 3, 2), np.float32)
    positions[1, :, 0] = 3, 2.96, 2.9  # Towards the other by 4 cm, then by 6.
    # In both steps both stay on the line; the second has one symbol that is not 0.
    np.testing.assert_allclose(
        alpha_of(positions, None, "quantised")[0, 1], [0, 1 / 80, 1 / 27]
    )
    np.testing.assert_allclose(alpha_of(positions)[0, 1], [0, 1 / 27, 1 / 27])


@pytest.mark.parametrize("weighting", NAMES)
@given(seed=st.integers(0, 2**32 - 1), agents=st.sampled_from([1, 2, 5]))
@example(seed=481, agents=2)
@example(seed=0, agents=1)
def test_neither_padding_nor_order_changes_a_weight(weighting, seed, agents):
    """An agent alone weighs nothing."""
    draw = np.random.default_rng(seed)
    positions = walks(9, seed) + draw.normal(0, 0.1, (9, 8, 2)).astype(np.float32)
    slots = draw.permutation(9)[:agents]
    valid = np.isin(np.arange(9), slots)
    padded = np.asarray(alpha_of(positions, valid, weighting))
    alone = np.asarray(alpha_of(positions[slots], weighting=weighting))
    np.testing.assert_array_equal(padded[np.ix_(slots, slots)], alone)
    assert not padded[~valid].any()
    assert not padded[:, ~valid].any()
    assert agents > 1 or not padded.any()


def test_a_table_is_learned():
    weighting, positions = Learned(), walks(3)
    total = jax.jit(
        jax.grad(lambda parameters: weighting.alpha(parameters, positions).sum())
    )
    gradient = total(initial_parameters(weighting))
    assert float(gradient["unobserved"]) == 6  # ordered pairs
    codes = np.asarray(jax.jit(weighting.codes)({}, positions))[~np.eye(3, dtype=bool)]
    np.testing.assert_array_equal(
        gradient["table"], np.bincount(codes.ravel(), minlength=81)
    )
    np.testing.assert_array_equal(
        alpha_of(positions, None, "learned"), alpha_of(positions)
    )


def test_the_wrong_pairs_get_the_same_weights():
    positions = np.random.default_rng(0).normal(0, 0.06, (5, 8, 2)).cumsum(axis=1)
    positions, valid = positions.astype(np.float32), np.array([1, 1, 0, 1, 1], bool)
    quantised = np.asarray(alpha_of(positions, valid, "quantised"))
    shuffled = np.asarray(alpha_of(positions, valid, "shuffled"))
    np.testing.assert_array_equal(
        np.sort(shuffled, axis=None), np.sort(quantised, axis=None)
    )
    distance = np.linalg.norm(positions[:, -1] - positions[0, -1], axis=-1)
    order = sorted((1, 3, 4), key=lambda j: distance[j])
    # Each has the weights of the next nearer one, the nearest those of the farthest.
    for j, source in zip(order, np.roll(order, 1)):
        np.testing.assert_array_equal(shuffled[0, j, 1:], quantised[0, source, :0:-1])
    assert (shuffled != quantised).mean() > 0.2


@pytest.mark.parametrize(
    "text", ["quantised,learned=true", "soft,learned=true", "learned"]
)
def test_learned_parameters_have_gradients(text):
    weighting = from_text(text)
    positions = np.random.default_rng(0).normal(0, 0.05, (4, 8, 2)).cumsum(axis=1)
    positions[3] = positions[2]  # Two at the same place.
    parameters = initial_parameters(weighting)
    weights = np.random.default_rng(1).normal(size=(4, 4, 8))
    gradient = jax.jit(
        jax.grad(lambda learned: (weighting.alpha(learned, positions) * weights).sum())
    )(parameters)
    assert gradient.keys() == parameters.keys() != set()
    for name, value in gradient.items():
        assert np.isfinite(value).all()
        assert np.abs(value).max() > 1e-3, name
    # Training starts from the weights of the options; `quantised` is hard, straight
    # through.
    if weighting.title != "learned":
        options = make_weighting(weighting.title)(positions)
        np.testing.assert_allclose(
            make_weighting(weighting)(positions), options, atol=1e-6
        )


@pytest.mark.slow
def test_a_function_as_a_weighting():
    @register_weighting("nearness", reach=2.0)
    def nearness(positions, valid, reach):
        return jnp.exp(
            -jnp.linalg.norm(positions[:, None] - positions[None], axis=-1) / reach
        )

    weighting = from_text("nearness")
    assert initial_parameters(weighting) == {"reach": 2.0}
    assert pickle.loads(pickle.dumps(weighting)) == weighting != Cnd()
    assert weighting.name == "nearness"
    positions, valid = np.zeros((3, 4, 2), np.float32), np.array([True, True, False])
    positions[1, :, 0] = 2
    alpha = make_weighting("nearness")(positions, valid)
    np.testing.assert_allclose(alpha[0, 1], np.exp(-1), rtol=1e-6)
    np.testing.assert_array_equal(alpha[0, 0], 1)
    assert not np.asarray(alpha[2]).any()
    assert alpha.dtype == jnp.float32
    for name, reason in {
        "cnd": "another weighting 'cnd'",
        "a,b": "cannot name",
    }.items():
        with pytest.raises(InputError, match=reason):
            register_weighting(name)(nearness)
    register_weighting("nearness", replace=True)(
        lambda positions, valid: 0 * positions[..., 0]
    )
    assert initial_parameters(from_text("nearness")) == {}
    with pytest.raises(
        InputError, match=r"nearness: returns \[3, 4\], not \[3, 3, 4\]"
    ):
        make_weighting("nearness")(positions, valid)


def test_a_class_as_a_weighting_has_options():
    @register_weighting("constant")
    @dataclasses.dataclass(frozen=True)
    class Constant(Weighting):
        value: Positive = 0.5

        def weigh(self, parameters, positions, valid, period):
            return jnp.full((len(positions), *positions.shape[:2]), self.value)

    assert from_text("constant,value=0.25") == Constant(0.25)
    assert alpha_of(walks(2), weighting=Constant(0.25))[0, 1, 0] == 0.25
    with pytest.raises(InputError, match="value must be positive"):
        make_weighting("constant,value=0")


def test_the_name_is_the_text_form():
    assert from_text("soft,temperature=0.125") == Soft(temperature=0.125)
    alphas = [alpha_of(walks(3), weighting=Soft(temperature=t)) for t in (0.125, 12.5)]
    assert np.abs(alphas[0] - alphas[1]).max() > 1e-4
    assert (
        Soft(temperature=0.1, learned=True).name == "soft,temperature=0.1,learned=true"
    )
    for name, weighting in WEIGHTINGS.items():
        assert weighting().name == name
