import functools
from unittest import mock

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from neurosym_jax.errors import InputError
from neurosym_jax.symbolic.built_in import alpha_from_states, table_of
from neurosym_jax.symbolic.cnd import alpha_table
from neurosym_jax.symbolic.qtc import pairwise_qtc_c1
from neurosym_jax.symbolic.states import encode_state
from neurosym_jax.symbolic.weighting import initial_parameters, make_weighting, scene_alpha
from neurosym_jax.symbolic.weighting_config import WEIGHTINGS, WeightingConfig, register_weighting
from tests.symbolic import literal

NAMES = tuple(WEIGHTINGS)
RELEASED = WeightingConfig("cnd_shipped", convention="as_published", decimals=4)


@functools.cache
def compiled(kind):
    return jax.jit(make_weighting(kind))


def alpha_of(positions, valid=None, kind="cnd"):
    valid = np.ones(len(positions), bool) if valid is None else valid
    return compiled(kind)(positions, valid)


@jax.jit
def codes_of(positions):
    return encode_state(pairwise_qtc_c1(positions))


def walks(agents, seed=0, steps=8):
    return np.random.default_rng(seed).integers(-9, 10, (agents, steps, 2)).astype(np.float32)


def jittered(agents, seed=0):
    """Walks in which nobody is as far from somebody as somebody else."""
    return walks(agents, seed) + np.random.default_rng(seed).normal(0, 0.1, (agents, 8, 2))


def test_shipped_weights_of_real_windows(real_windows):
    weigh = jax.jit(make_weighting(RELEASED))
    for positions, valid, expected in real_windows:
        alpha = np.asarray(weigh(positions, valid))[np.ix_(valid, valid)]
        np.testing.assert_array_equal(alpha, expected["alpha_shipped"])


@pytest.mark.usefixtures("double")
def test_shipped_weights_of_the_released_code(released):
    pairs = np.stack([released["k"], released["l"]], axis=1)
    alpha = jax.jit(jax.vmap(make_weighting(RELEASED)))(pairs)
    assert alpha.dtype == jnp.float64
    np.testing.assert_array_equal(alpha[:, 0, 1, 1:], released["alpha_reference"])


def test_the_authors_own_table(shared):
    authors = np.load(shared / "golden" / "qtc" / "cnd.npz")["C1_alpha_neurosym"]
    np.testing.assert_array_equal(table_of(RELEASED), authors)


def test_shipped_tables():
    rows = literal.states("c1")
    exact = [literal.shipped_alpha(state) for state in rows]
    np.testing.assert_array_equal(table_of(WeightingConfig("cnd_shipped")), exact)
    printed = [[0.0625, 0.0417, 0.0278, 0.0185, 0.0123][state.count(0)] for state in rows]
    np.testing.assert_array_equal(table_of(RELEASED), printed)


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


def test_quantised_symbols_are_zero_below_five_centimetres():
    positions = np.zeros((2, 3, 2), np.float32)
    positions[1, :, 0] = 3, 2.96, 2.9  # Towards the other by 4 cm, then by 6.
    # In both steps nobody leaves the line; the second has one symbol that is not 0.
    np.testing.assert_allclose(alpha_of(positions, None, "quantised")[0, 1], [0, 1 / 80, 1 / 27])
    np.testing.assert_allclose(alpha_of(positions)[0, 1], [0, 1 / 27, 1 / 27])


@pytest.mark.parametrize("weighting", NAMES)
@pytest.mark.parametrize("slots", [1, 2, 5])
def test_whoever_is_alone_weighs_nothing(weighting, slots):
    valid = np.arange(slots) == slots - 1
    assert not np.asarray(alpha_of(walks(slots), valid, weighting)).any()


@pytest.mark.parametrize("weighting", NAMES)
@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), agents=st.sampled_from([1, 2, 5, 9]))
def test_neither_padding_nor_order_changes_a_weight(weighting, seed, agents):
    positions, draw = jittered(9, seed).astype(np.float32), np.random.default_rng(seed)
    slots = draw.permutation(9)[:agents]
    valid = np.isin(np.arange(9), slots)
    padded = np.asarray(alpha_of(positions, valid, weighting))
    alone = np.asarray(alpha_of(positions[slots], kind=weighting))
    np.testing.assert_array_equal(padded[np.ix_(slots, slots)], alone)
    assert not padded[~valid].any()
    assert not padded[:, ~valid].any()


def test_no_padding_need_not_be_said():
    np.testing.assert_array_equal(make_weighting()(walks(3)), alpha_of(walks(3)))
    assert not np.asarray(make_weighting("ones")(walks(1))).any()


def test_one_step_has_no_state_yet():
    np.testing.assert_array_equal(alpha_of(walks(2, steps=1))[..., 0], np.eye(2))


def test_scenes_are_mapped():
    batch = np.stack([walks(4, seed) for seed in range(3)])
    valid = np.arange(4)[None] < np.array([[4], [1], [2]])
    mapped = jax.jit(jax.vmap(make_weighting()))(batch, valid)
    for scene in range(3):
        np.testing.assert_array_equal(mapped[scene], alpha_of(batch[scene], valid[scene]))


def test_a_table_is_learnt():
    config = WeightingConfig("learned")
    start = initial_parameters(config)
    positions = walks(3)
    total = jax.jit(jax.grad(lambda parameters: scene_alpha(config, parameters, positions).sum()))
    gradient = total(start)
    assert float(gradient["unobserved"]) == 6  # ordered pairs
    others = ~np.eye(3, dtype=bool)
    codes = np.asarray(codes_of(positions))[others]
    np.testing.assert_array_equal(gradient["table"], np.bincount(codes.ravel(), minlength=81))
    np.testing.assert_array_equal(alpha_of(positions, None, "learned"), alpha_of(positions))


def test_the_wrong_pairs_get_the_same_weights():
    positions = np.random.default_rng(0).normal(0, 0.06, (5, 8, 2)).cumsum(axis=1)
    positions, valid = positions.astype(np.float32), np.array([1, 1, 0, 1, 1], bool)
    quantised = np.asarray(alpha_of(positions, valid, "quantised"))
    shuffled = np.asarray(alpha_of(positions, valid, "shuffled"))
    np.testing.assert_array_equal(np.sort(shuffled, axis=None), np.sort(quantised, axis=None))
    apart = np.linalg.norm(positions[:, -1] - positions[0, -1], axis=-1)
    nearest, *_, farthest = sorted((1, 3, 4), key=lambda j: apart[j])
    np.testing.assert_array_equal(shuffled[0, nearest, 1:], quantised[0, farthest, :0:-1])
    assert (shuffled != quantised).mean() > 0.2


def test_transitions_weigh_as_often_as_they_were_seen():
    config = WeightingConfig("transition", quantisation_factor=1.5)
    scenes = [(np.stack([walks(3, seed)]), np.array([[True, True, seed > 0]])) for seed in range(4)]
    parameters = initial_parameters(config, scenes)
    chains = [
        codes[0, i, j]
        for positions, valid in scenes
        for codes in [coarse_codes(positions)]
        for i in range(3)
        for j in range(3)
        if i != j and valid[0, i] and valid[0, j]
    ]
    seen = np.ones((81, 81))
    for chain in chains:
        np.add.at(seen, (chain[:-1], chain[1:]), 1)
    probability = seen / seen.sum(axis=1, keepdims=True)
    np.testing.assert_allclose(parameters["transition"], probability, rtol=1e-6)
    alpha = scene_alpha(config, parameters, scenes[1][0][0])
    chain = coarse_codes(scenes[1][0])[0, 0, 1]
    wanted = [0, seen[chain[0]].sum() / seen.sum(), *probability[chain[:-1], chain[1:]]]
    np.testing.assert_allclose(alpha[0, 1], wanted, rtol=1e-5)
    np.testing.assert_array_equal(initial_parameters(config)["transition"], np.float32(1 / 81))


@jax.jit
@jax.vmap
def coarse_codes(positions):
    return encode_state(pairwise_qtc_c1(positions, quantisation_factor=1.5))


@pytest.mark.parametrize("kind", ["quantised", "soft", "learned", "transition"])
def test_what_is_learned_has_gradients(kind):
    config = WeightingConfig(kind, learned=True)
    positions = np.random.default_rng(0).normal(0, 0.05, (4, 8, 2)).cumsum(axis=1)
    positions[3] = positions[2]  # Two on one spot.
    parameters = initial_parameters(config)
    weights = np.random.default_rng(1).normal(size=(4, 4, 8))
    gradient = jax.jit(
        jax.grad(lambda given: (scene_alpha(config, given, positions) * weights).sum())
    )(parameters)
    assert gradient.keys() == parameters.keys() != set()
    for name, value in gradient.items():
        assert np.isfinite(value).all()
        assert np.abs(value).max() > 1e-3, name
    start = make_weighting(config)(positions)
    if kind == "quantised":  # Straight through: the weights are the hard ones.
        np.testing.assert_array_equal(start, make_weighting(kind)(positions))


def test_what_is_estimated_is_not_trained():
    config = WeightingConfig("transition")
    total = jax.grad(lambda given: scene_alpha(config, given, walks(3)).sum())
    assert not any(value.any() for value in total(initial_parameters(config)).values())


def test_soft_weights_are_the_quantised_where_symbols_are_certain():
    sharp = WeightingConfig("soft", temperature=1e-4)
    np.testing.assert_allclose(
        make_weighting(sharp)(walks(4)), alpha_of(walks(4), None, "quantised"), atol=1e-6
    )


def test_integer_positions_give_real_weights():
    alpha = alpha_of(walks(3).astype(np.int32))
    np.testing.assert_array_equal(alpha, alpha_of(walks(3)))
    assert alpha.dtype == jnp.float32


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"kind": "cdn"}, r"'cdn': did you mean 'cnd'\? there are .*, shuffled \(--plugin"),
        ({"kind": "ones", "learned": True}, "'ones' has nothing to learn"),
        ({"quantisation_factor": -0.1}, "quantisation_factor must be at least 0"),
        (
            {"side_quantisation_factor": float("nan")},
            "side_quantisation_factor must be a finite",
        ),
        ({"temperature": 0.0}, "temperature must be positive"),
        (
            {"convention": "lines"},
            "convention must be one of distance, line, as",
        ),
        ({"kind": "quantised", "quantisation_factor": 0.0, "learned": True}, "cannot be learned"),
    ],
)
def test_what_is_no_weighting(settings, message):
    with pytest.raises(InputError, match=message):
        WeightingConfig(**settings)


@mock.patch.dict(WEIGHTINGS)
def test_a_weighting_of_ones_own(monkeypatch):

    @register_weighting("nearness", reach=2.0)
    def nearness(positions, valid, reach):
        return jnp.exp(-jnp.linalg.norm(positions[:, None] - positions[None], axis=-1) / reach)

    config = WeightingConfig("nearness")
    assert config.learned
    assert initial_parameters(config) == {"reach": 2.0}
    positions, valid = np.zeros((3, 4, 2), np.float32), np.array([True, True, False])
    positions[1, :, 0] = 2
    alpha = make_weighting("nearness")(positions, valid)
    np.testing.assert_allclose(alpha[0, 1], np.exp(-1), rtol=1e-6)
    np.testing.assert_array_equal(alpha[0, 0], 1)
    assert not np.asarray(alpha[2]).any()
    for name, reason in {"cnd": "another weighting 'cnd'", "a,b": "cannot name"}.items():
        with pytest.raises(InputError, match=reason):
            register_weighting(name)(nearness)


@mock.patch.dict(WEIGHTINGS)
def test_what_is_replaced_is_gone(monkeypatch):
    register_weighting("constant")(lambda positions, valid: 0 * positions[:, None, :, 0] + 1)
    config, positions = WeightingConfig("constant"), walks(2)
    weigh = jax.jit(scene_alpha, static_argnums=0)
    assert weigh(config, {}, positions)[0, 1, 0] == 1

    def twos(positions, valid):
        return 0 * positions[:, None, :, 0] + 2

    with pytest.raises(InputError, match="replace=True"):
        register_weighting("constant")(twos)
    assert weigh(config, {}, positions)[0, 1, 0] == 1
    register_weighting("constant", replace=True)(twos)
    assert weigh(config, {}, positions)[0, 1, 0] == 2


def test_the_text_form_is_what_documents_say():
    alpha = alpha_of(walks(3), kind="soft,temperature=0.05")
    wanted = alpha_of(walks(3), kind=WeightingConfig("soft", temperature=0.05))
    np.testing.assert_array_equal(alpha, wanted)
    assert np.abs(alpha - alpha_of(walks(3), kind="soft,temperature=5.0")).max() > 1e-4
    with pytest.raises(InputError, match="weighting: unknown field 'temprature'"):
        make_weighting("soft,temprature=0.05")
