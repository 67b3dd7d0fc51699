import dataclasses

import jax
import numpy as np
import pytest

from neurosym_jax.training.gradients import Counts
from neurosym_jax.training.shards import advance_in_shards
from neurosym_jax.training.step import Part, initial_state, learn_to_forecast, split, train_step
from neurosym_jax.training.stream import SceneStream


@pytest.fixture(scope="module")
def shards(windows):
    """Two shards of different scenes, `[shards, scenes, ...]`."""
    return SceneStream(windows, 4, seed=0).steps(0, 2)


def start(run, groups):
    example = jax.tree.map(lambda leaf: leaf[0, 0], groups[0])
    return jax.jit(lambda key: initial_state(run.generator, run.config, example, key))(
        jax.random.key(0)
    )


@pytest.mark.slow
def test_shards_are_their_batch(run, shards):
    """Where nothing is random, so that parts and the whole have the same to learn."""
    generator = dataclasses.replace(run.generator, noise_dim=0)
    config = dataclasses.replace(run.config, shards=2, rotate=0.0, scale=0.0, jitter=0.0)
    run = dataclasses.replace(run, generator=generator, config=config)
    state, key = start(run, shards), jax.random.key(1)
    agents = sum(group.valid.sum(axis=(1, 2)) for group in shards)
    assert agents[0] != agents[1]

    groups = jax.tree.map(lambda leaf: leaf[None, None], shards)
    apart, metrics = advance_in_shards(generator, config, key, state, groups)
    whole = jax.tree.map(lambda leaf: leaf.reshape(1, -1, *leaf.shape[2:]), shards)
    together, wanted = jax.jit(
        lambda key: train_step(generator, config, state, whole, jax.random.fold_in(key, 0))
    )(key)
    for name, value in wanted.items():
        assert metrics[name] == pytest.approx(float(value), rel=1e-4)
    # After one step Adam has its gradient in the first moment.
    jax.tree.map(
        lambda a, b: np.testing.assert_allclose(a, b, rtol=1e-3, atol=1e-6),
        apart.generator_optimizer,
        together.generator_optimizer,
    )
    assert int(apart.step) == 1


@pytest.mark.slow
def test_every_shard_has_its_own_noise(run, shards):
    state = start(run, shards)
    groups = jax.tree.map(lambda leaf: leaf[0], shards)

    @jax.jit
    def loss(index):
        part = Part(index, Counts.of(groups))
        keys = split(jax.random.key(1))
        return learn_to_forecast(run.generator, run.config, state, groups, keys, part)[1]["g_loss"]

    assert loss(0) == loss(0) != loss(1)
