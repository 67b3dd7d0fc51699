"""Poolings against their formulas for every pair."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose

from neurosym_jax.errors import InputError
from neurosym_jax.models import Generator
from neurosym_jax.models.sgan.network import (
    GeneratorConfig,
    PoolNetwork,
    _DescribedNetwork,
    _GridNetwork,
    _IjcnnNetwork,
    _leaking_relu,
    _RosNetwork,
)
from neurosym_jax.scene import make_scene
from tests.networks import random_params

N, T, E, H, B = 6, 5, 4, 3, 7
RNG = np.random.default_rng(0)
HIDDEN = RNG.normal(size=(N, H)).astype(np.float32)
OBSERVED = RNG.normal(0, 0.5, (N, T, 2)).cumsum(axis=1).astype(np.float32)
POSITIONS = RNG.uniform(-1.5, 1.5, (N, 2)).astype(np.float32)
ALPHA = RNG.uniform(size=(N, N, T)).astype(np.float32)
ALL = np.ones(N, bool)
HIDDEN_POOLING = PoolNetwork(embedding_dim=E, h_dim=H, hidden_dim=9, bottleneck_dim=B)
GRID = _GridNetwork(h_dim=H, grid_size=4, neighborhood_size=1.6)
DESCRIBED, ROS = (
    network(T, E, H, 9, B) for network in (_DescribedNetwork, _RosNetwork)
)


def relu_layers(x, mlp):
    for index in range(len(mlp)):
        layer = mlp[f"layer_{index}"]
        x = (x @ layer["kernel"] + layer["bias"]).clip(0)
    return x


def dense(x, layer):
    return x @ layer["kernel"] + layer["bias"]


def track_of(agent):
    return jnp.array(OBSERVED)[agent]


def ends(layer, i, j):
    """The last positions alone."""
    return dense(jnp.array(POSITIONS)[j] - jnp.array(POSITIONS)[i], layer)


def paper(layer, i, j):
    """Each step's embedding, by its alpha."""
    return jnp.array(ALPHA)[i, j][:, None] * dense(track_of(j) - track_of(i), layer)


def robot(layer, i, j):
    """The whole history embedded at once, time-major: x0, y0, x1, y1, ..."""
    history = (track_of(j) - track_of(i)).reshape(-1)
    return dense(history, layer).reshape(T, E) * jnp.array(ALPHA)[i, j][:, None]


@pytest.mark.parametrize(
    ("module", "others", "embed", "kernel"),
    [
        (HIDDEN_POOLING, (POSITIONS,), ends, 2),
        (DESCRIBED, (OBSERVED, ALPHA), paper, 2),
        (ROS, (OBSERVED, ALPHA), robot, 2 * T),
    ],
)
def test_the_maximum_over_pairs_of_a_perceptron(module, others, embed, kernel):
    """The module is `MLP [embed(i, j); h_j]`, of which the maximum over j is taken."""
    inputs = others[0], ALL, *others[1:]
    params = random_params(module, HIDDEN, *inputs, std=0.5)
    assert params["params"]["spatial_embedding"]["kernel"].shape[0] == kernel

    def written_out(params, hidden):
        layer, mlp = params["params"]["spatial_embedding"], params["params"]["mlp"]

        def of_pair(i, j):
            return relu_layers(
                jnp.concatenate([embed(layer, i, j).ravel(), hidden[j]]), mlp
            )

        people = jnp.arange(N)
        return jax.vmap(
            lambda i: jax.vmap(lambda j: of_pair(i, j))(people).max(axis=0)
        )(people)

    def pooled(params, hidden):
        return module.apply(params, hidden, *inputs)

    result, expected = (
        jax.jit(function)(params, HIDDEN) for function in (pooled, written_out)
    )
    assert_allclose(result, expected, atol=1e-5)
    # Nothing is compared where the last ReLU has shut everything, or where all people
    # are the same.
    assert np.ptp(expected, axis=0).max() > 0.1
    result, expected = (
        jax.jit(
            jax.grad(lambda *others, pool=function: (pool(*others) ** 2).sum(), (0, 1))
        )(params, HIDDEN)
        for function in (pooled, written_out)
    )
    jax.tree.map(lambda *pair: assert_allclose(*pair, atol=1e-4), result, expected)
    assert min(np.abs(leaf).max() for leaf in jax.tree.leaves(expected)) > 0.1


def test_social_pooling_sums_hidden_states_where_others_stand():
    params = random_params(GRID, HIDDEN, POSITIONS, ALL, std=0.5)
    mlp, rows = params["params"]["mlp"], []
    for i in range(N):
        grid = np.zeros((4, 4, H))
        for j in set(range(N)) - {i}:
            x, y = POSITIONS[j] - POSITIONS[i]
            if abs(x) < 0.8 and abs(y) < 0.8:  # Cells of 0.4 m.
                grid[int((0.8 - y) / 0.4), int((x + 0.8) / 0.4)] += HIDDEN[j]
        rows.append(relu_layers(grid.reshape(-1), mlp))
    grid = jax.jit(GRID.apply)(params, HIDDEN, POSITIONS, ALL)
    assert_allclose(grid, np.array(rows), atol=1e-5)
    assert np.abs(np.array(rows) - relu_layers(np.zeros(16 * H), mlp)).max() > 0.1


@pytest.mark.parametrize("module", [HIDDEN_POOLING, GRID], ids=["hidden", "grid"])
def test_only_valid_agents_count(module):
    params = random_params(module, HIDDEN, POSITIONS, ALL, std=0.5)
    apply = jax.jit(module.apply)
    valid = np.array([True, True, False, True, False, False])
    pooled = np.asarray(apply(params, HIDDEN, POSITIONS, valid))
    alone = apply(params, HIDDEN[valid], POSITIONS[valid], np.ones(3, bool))
    assert_allclose(pooled[valid], alone, atol=1e-6)
    assert np.isfinite(pooled).all()
    complete = np.asarray(apply(params, HIDDEN, POSITIONS, ALL))
    assert np.abs(complete[valid] - alone).max() > 1e-3
    assert np.isfinite(apply(params, HIDDEN, POSITIONS, ~ALL)).all()


@pytest.mark.slow
@pytest.mark.parametrize("valid", [ALL, np.arange(N) == 2], ids=["all", "alone"])
@pytest.mark.parametrize("module", [DESCRIBED, ROS], ids=["described", "ros"])
def test_gradients_where_people_coincide(module, valid):
    params = random_params(module, HIDDEN, OBSERVED, ALL, ALPHA, std=0.5)

    def total(params, hidden, observed, alpha):
        return jnp.square(module.apply(params, hidden, observed, valid, alpha)).sum()

    gradients = jax.jit(jax.grad(total, argnums=(0, 1, 2, 3)))(
        params, HIDDEN, 0 * OBSERVED, ALPHA
    )
    assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(gradients))
    assert any(leaf.any() for leaf in jax.tree.leaves(gradients[0]))


def test_units_that_are_not_above_0_get_a_share_of_the_gradients_that_raise_them():
    unit = jnp.array([-1.0, 0.0, 2.0])
    _, pull = jax.vjp(_leaking_relu, unit, jnp.float32(0.1))
    for sign, expected in ((-1.0, [-0.1, -0.1, -1]), (1.0, [0, 0, 1])):
        assert_allclose(pull(jnp.full(3, sign))[0], expected)


def test_a_missing_alpha_is_named():
    config = GeneratorConfig(pooling="as_described,hidden_dim=4", obs_len=T)
    scene, noise = make_scene(OBSERVED), np.zeros(config.noise_dim)
    with pytest.raises(InputError, match=r"NeuroSyM needs alpha .* nj\.forecast"):
        jax.eval_shape(Generator(config).init, jax.random.key(0), scene, noise)


def test_the_ijcnn_release_has_one_maximum_over_all_but_padding():
    network, present = _IjcnnNetwork(T, E, H, 9, B), np.arange(N) < N - 2
    rows = ALPHA[0]
    params = jax.jit(network.init)(jax.random.key(2), HIDDEN, ALL, rows)
    pooled = jax.jit(network.apply)(params, HIDDEN, present, rows)
    params = jax.tree.map(np.asarray, params)
    weights = params["params"]
    embedded = (rows[..., None] * weights["spatial_embedding"]["bias"]).reshape(N, -1)
    units = relu_layers(np.concatenate([embedded, HIDDEN], axis=1), weights["mlp"])
    assert units[~present].max() > units[present].max()
    assert_allclose(pooled, np.tile(units[present].max(axis=0), (N, 1)), rtol=1e-5)
