"""Samples that are exchanged for draws, where these say more of what may happen."""

import jax
import jax.numpy as jnp
import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from neurosym_jax.models.place import samples as place_samples
from neurosym_jax.models.place.mixture import Remembered
from neurosym_jax.models.place.samples import TRUST, exchange_scene

exchange = jax.jit(place_samples.exchange)


def at(*places):
    """[k, 1, 1, 2] futures of one person and one step, at these x."""
    return jnp.array([[[[place, 0.0]]] for place in places])


def exchanged(samples, probability, draws, share):
    valid = jnp.ones(1, bool)
    result = exchange(samples, probability, draws, valid, jnp.array([share]))
    return sorted(np.asarray(result)[:, 0, 0, 0].tolist())


def test_the_sample_that_covers_least_goes():
    """0 is near 1, and costs less than 10 does; 1 is nearer to 5 than any other."""
    samples, draws = at(0.0, 1.0, 10.0), at(*[5.0] * 8)
    probability = jnp.array([0.2, 0.6, 0.2])
    assert exchanged(samples, probability, draws, 1.0) == [1.0, 5.0, 10.0]


def test_the_most_probable_sample_stays():
    """0 would go, for -0.2 is near it, and nearer to some draws."""
    samples, draws = at(0.0, -0.2, 10.0), at(*[5.0] * 4, *[-0.9] * 4)
    probability = jnp.array([0.4, 0.3, 0.3])
    assert exchanged(samples, probability, draws, 1.0) == [0.0, 5.0, 10.0]


def test_without_a_memory_nothing_is_exchanged():
    samples, draws = at(0.0, 1.0, 10.0), at(*[5.0] * 8)
    probability = jnp.array([0.2, 0.6, 0.2])
    assert exchanged(samples, probability, draws, 0.0) == [0.0, 1.0, 10.0]
    assert exchanged(at(3.0), jnp.ones(1), draws, 1.0) == [3.0]


def test_an_exchange_has_to_pay():
    """Draws have half of the probability at most, so a rare one displaces no sample."""
    samples, draws = at(0.0, 6.0), at(*[5.0] * 9, 1.0)
    probability = jnp.array([0.5, 0.5])
    # 0.5 * 0.5 * 5 m are lost with the sample at 6 or 0, and 0.5 * 1 m gained.
    assert exchanged(samples, probability, draws, 1.0) == [0.0, 5.0]
    assert exchanged(samples, probability, draws, 0.1) == [0.0, 6.0]


def expected_error(chosen, samples, probability, draws, share):
    """Mean error of the best sample of the scene, and of each person's best, by loops."""
    total = 0.0
    truths = [
        (sample, (1 - TRUST * share) * p) for sample, p in zip(samples, probability)
    ]
    truths += [(draw, TRUST * share / len(draws)) for draw in draws]
    for truth, weight in truths:
        errors = [
            np.linalg.norm(sample - truth, axis=-1).mean(axis=-1) for sample in chosen
        ]
        of_scene = min(error.mean() for error in errors)
        of_each = np.min(errors, axis=0).mean()
        total += weight * (of_scene + of_each)
    return total


def test_a_candidate_is_the_best_for_the_scene_and_for_each_person():
    for seed in range(20):
        rng = np.random.default_rng(seed)
        samples = rng.normal(0, 1, (2, 2, 1, 2)).astype(np.float32)
        draws = rng.normal(0, 1, (9, 2, 1, 2)).astype(np.float32)
        arguments = samples, np.float32([0.9, 0.1]), draws
        result = np.asarray(exchange(*arguments, np.ones(2, bool), np.ones(2)))
        candidates = (samples[1], *draws)
        errors = [
            expected_error([samples[0], candidate], *arguments, 1.0)
            for candidate in candidates
        ]
        best = candidates[int(np.argmin(errors))]
        assert np.array_equal(result, [samples[0], best])


@given(st.integers(0, 2**31))
def test_the_expected_error_falls_and_padding_and_order_are_nothing(seed):
    rng = np.random.default_rng(seed)
    samples = rng.normal(0, 1, (5, 2, 3, 2)).astype(np.float32)
    draws = rng.normal(0.5, 1, (7, 2, 3, 2)).astype(np.float32)
    probability = rng.dirichlet(np.ones(5)).astype(np.float32)
    share = np.float32([1.0, 0.5])
    arguments = samples, probability, draws

    result = np.asarray(exchange(*arguments, np.ones(2, bool), share))
    mean = 0.75
    before, after = (
        expected_error(chosen, samples, probability, draws, mean)
        for chosen in (samples, result)
    )
    assert after <= before + 1e-5
    central = probability.argmax()
    assert np.array_equal(result[central], samples[central])

    turned = exchange(
        samples[:, ::-1], probability, draws[:, ::-1], np.ones(2, bool), share[::-1]
    )
    assert np.array_equal(np.asarray(turned)[:, ::-1], result)
    wide = [np.pad(part, ((0, 0), (0, 2), (0, 0), (0, 0))) for part in (samples, draws)]
    wide[1][:, 2:] = 50
    valid = np.arange(4) < 2
    padded = exchange(
        wide[0], probability, wide[1], valid, np.pad(share, (0, 2), constant_values=1)
    )
    assert np.array_equal(np.asarray(padded)[:, :2], result)


def test_a_scene_far_from_the_origin_loses_nothing():
    far = np.array([564_304.0, 5_933_435.0])
    samples = np.array([0.0, 1.0, 10.0])[:, None, None, None] * np.ones((3, 1, 4, 2))
    draws = np.full((8, 1, 4, 2), 5.0)
    memory = Remembered(np.zeros((1, 2, 4, 2)), np.ones((1, 2)), np.zeros((1, 2)))
    probability = np.array([0.2, 0.6, 0.2])
    near = exchange_scene(samples, probability, draws, memory)
    assert sorted(near[:, 0, 0, 0].round(4).tolist()) == [1.0, 5.0, 10.0]
    there = exchange_scene(samples + far, probability, draws + far, memory)
    assert_allclose(there - far, near, atol=1e-5)
