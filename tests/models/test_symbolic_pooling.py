"""NeuroSyM's poolings, folded as they are, against their formulas written out for every pair."""

import jax
import numpy as np
import pytest
from numpy.testing import assert_allclose

from neurosym_jax.errors import InputError
from neurosym_jax.models import Generator
from neurosym_jax.models.config import GeneratorConfig
from neurosym_jax.models.neurosym import _DescribedNetwork, _RosNetwork
from neurosym_jax.scene import make_scene

N, T, E, H, B = 6, 5, 4, 3, 7
SIZES = (T, E, H, 9, B)
RNG = np.random.default_rng(0)
HIDDEN = RNG.normal(size=(N, H)).astype(np.float32)
OBSERVED = RNG.normal(0, 0.5, (N, T, 2)).cumsum(axis=1).astype(np.float32)
ALPHA = RNG.uniform(size=(N, N, T)).astype(np.float32)
ALL = np.ones(N, bool)
OF_PAIRS = [_DescribedNetwork(*SIZES), _RosNetwork(*SIZES)]
EACH = pytest.mark.parametrize("module", OF_PAIRS, ids=lambda module: type(module).__name__)


def with_random_params(module):
    shapes = jax.eval_shape(module.init, jax.random.key(0), HIDDEN, OBSERVED, ALL, ALPHA)
    rng = np.random.default_rng(1)
    return jax.tree.map(lambda leaf: rng.normal(0, 0.5, leaf.shape).astype(np.float32), shapes)


def pool(module, params):
    return np.asarray(jax.jit(module.apply)(params, HIDDEN, OBSERVED, ALL, ALPHA))


def literally(params, embed):
    """`[alpha-weighted embedding of every step, flattened; h_j]`, MLP, maximum over j.

    `embed(i, j)` gives the weighted embedding [T, E] of the pair.
    """
    mlp = params["params"]["mlp"]
    rows = []
    for i in range(N):
        candidates = []
        for j in range(N):
            x = np.concatenate([embed(i, j).reshape(-1), HIDDEN[j]])
            for layer in (mlp["layer_0"], mlp["layer_1"]):
                x = np.maximum(x @ layer["kernel"] + layer["bias"], 0)
            candidates.append(x)
        rows.append(np.max(candidates, axis=0))
    return np.array(rows)


def test_as_described_is_the_papers_formula():
    module = _DescribedNetwork(*SIZES)
    params = with_random_params(module)
    dense = params["params"]["spatial_embedding"]
    assert dense["kernel"].shape == (2, E)

    def embed(i, j):
        offsets = OBSERVED[j] - OBSERVED[i]
        return ALPHA[i, j][:, None] * (offsets @ dense["kernel"] + dense["bias"])

    wanted = literally(params, embed)
    assert_allclose(pool(module, params), wanted, atol=1e-5)
    # Nothing is compared where the last ReLU has shut everything, or where everybody is the same.
    assert (wanted > 0.1).mean() > 0.5
    assert np.ptp(wanted, axis=0).max() > 0.1


def test_ros_embeds_the_whole_history_at_once():
    module = _RosNetwork(*SIZES)
    params = with_random_params(module)
    dense = params["params"]["spatial_embedding"]
    assert dense["kernel"].shape == (2 * T, E * T)

    def embed(i, j):
        history = (OBSERVED[j] - OBSERVED[i]).reshape(-1)  # Time-major: x0, y0, x1, y1, ...
        blocks = (history @ dense["kernel"] + dense["bias"]).reshape(T, E)
        return blocks * ALPHA[i, j][:, None]

    wanted = literally(params, embed)
    assert_allclose(pool(module, params), wanted, atol=1e-5)
    assert np.ptp(wanted, axis=0).max() > 0.1


@EACH
def test_gradients_where_people_coincide(module):
    params = with_random_params(module)
    zeros = np.zeros_like(OBSERVED)

    def total(params, hidden, observed, alpha):
        return module.apply(params, hidden, observed, ALL, alpha).sum()

    gradients = jax.jit(jax.grad(total, argnums=(0, 1, 2, 3)))(params, HIDDEN, zeros, ALPHA)
    assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(gradients))
    assert any(leaf.any() for leaf in jax.tree.leaves(gradients[0]))


def test_a_missing_alpha_is_named():
    config = GeneratorConfig(pooling="as_described,hidden_dim=4", obs_len=T)
    scene, noise = make_scene(OBSERVED), np.zeros(config.noise_dim)
    with pytest.raises(InputError, match=r"NeuroSyM needs alpha .* nj\.forecast"):
        jax.eval_shape(Generator(config).init, jax.random.key(0), scene, noise)
