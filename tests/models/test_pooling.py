import jax
import numpy as np
import pytest
from numpy.testing import assert_allclose

from neurosym_jax.models.pool_net import PoolNetwork
from neurosym_jax.models.social import _GridNetwork

RNG = np.random.default_rng(0)
HIDDEN = RNG.normal(size=(6, 5)).astype(np.float32)
POSITIONS = RNG.uniform(-1.5, 1.5, (6, 2)).astype(np.float32)
ALL = np.ones(6, bool)


def with_random_params(module):
    shapes = jax.eval_shape(module.init, jax.random.key(0), HIDDEN, POSITIONS, ALL)
    rng = np.random.default_rng(1)
    return jax.tree.map(lambda leaf: rng.normal(0, 0.5, leaf.shape).astype(np.float32), shapes)


def relu_layers(x, mlp):
    for index in range(len(mlp)):
        layer = mlp[f"layer_{index}"]
        x = np.maximum(x @ layer["kernel"] + layer["bias"], 0)
    return x


def pooled_by_pairs(params, hidden, positions):
    """SGAN's pooling as its code has it: concatenate for each pair, then the maximum over j."""
    dense, mlp = params["params"]["spatial_embedding"], params["params"]["mlp"]
    rows = []
    for i in range(len(hidden)):
        candidates = []
        for j in range(len(hidden)):
            embedded = (positions[j] - positions[i]) @ dense["kernel"] + dense["bias"]
            candidates.append(relu_layers(np.concatenate([embedded, hidden[j]]), mlp))
        rows.append(np.max(candidates, axis=0))
    return np.array(rows)


def pooled_by_grid(params, hidden, positions, cells, side):
    """S-LSTM's pooling: the hidden states of others, summed where they stand around i."""
    rows = []
    for i in range(len(hidden)):
        grid = np.zeros((cells, cells, hidden.shape[1]))
        for j in range(len(hidden)):
            x, y = positions[j] - positions[i]
            if j == i or abs(x) >= side / 2 or abs(y) >= side / 2:
                continue
            column = int(np.floor((x + side / 2) / side * cells))
            row = int(np.floor((side / 2 - y) / side * cells))
            grid[row, column] += hidden[j]
        rows.append(relu_layers(grid.reshape(-1), params["params"]["mlp"]))
    return np.array(rows)


def test_hidden_pooling_against_literal_pairs():
    module = PoolNetwork(embedding_dim=4, h_dim=5, hidden_dim=9, bottleneck_dim=3)
    params = with_random_params(module)
    wanted = pooled_by_pairs(params, HIDDEN, POSITIONS)
    assert_allclose(jax.jit(module.apply)(params, HIDDEN, POSITIONS, ALL), wanted, atol=1e-5)
    assert wanted.any()


def test_social_pooling_against_a_loop():
    module = _GridNetwork(h_dim=5, grid_size=4, neighborhood_size=2.0)
    params = with_random_params(module)
    wanted = pooled_by_grid(params, HIDDEN, POSITIONS, 4, 2.0)
    assert_allclose(jax.jit(module.apply)(params, HIDDEN, POSITIONS, ALL), wanted, atol=1e-5)
    alone = relu_layers(np.zeros(80), params["params"]["mlp"])
    assert np.abs(wanted - alone).max() > 0.1


MODULES = [
    PoolNetwork(embedding_dim=4, h_dim=5, hidden_dim=9, bottleneck_dim=3),
    _GridNetwork(h_dim=5, grid_size=4, neighborhood_size=2.0),
]


@pytest.mark.parametrize("module", MODULES)
def test_only_valid_agents_count(module):
    params = with_random_params(module)
    valid = np.array([True, True, False, True, False, False])
    pooled = jax.jit(module.apply)(params, HIDDEN, POSITIONS, valid)
    alone = jax.jit(module.apply)(params, HIDDEN[valid], POSITIONS[valid], np.ones(3, bool))
    assert_allclose(pooled[valid], alone, atol=1e-6)
    assert np.isfinite(pooled).all()
    everybody = jax.jit(module.apply)(params, HIDDEN, POSITIONS, ALL)
    assert np.abs(everybody[valid] - alone).max() > 1e-3
    assert np.isfinite(jax.jit(module.apply)(params, HIDDEN, POSITIONS, ~ALL)).all()
