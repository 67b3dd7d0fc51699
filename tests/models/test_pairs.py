"""The hand-written gradient of pooling against what JAX derives from the plain formula."""

from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
from numpy.testing import assert_allclose

from neurosym_jax.models.pairs import max_over_neighbours

AGENTS, HIDDEN, OUTPUTS = 6, 9, 4
VALID = np.array([True, True, False, True, True, True])


def first_layer(shared, own, theirs, of_pair):
    return (jnp.concatenate([theirs - own, of_pair]) @ shared) + 0.1


def pooled(shared, agents, neighbours, pairs, kernel, bias):
    second = SimpleNamespace(kernel=kernel, bias=bias)
    return jax.nn.relu(
        max_over_neighbours(first_layer, shared, agents, neighbours, pairs, second, VALID)
    )


def plainly(shared, agents, neighbours, pairs, kernel, bias):
    of_neighbours = jax.vmap(first_layer, in_axes=(None, None, 0, 0))
    before = jax.vmap(of_neighbours, in_axes=(None, 0, None, 0))(shared, agents, neighbours, pairs)
    after = jax.nn.relu(jax.nn.relu(before) @ kernel + bias)
    return jnp.where(VALID[None, :, None], after, 0).max(axis=1)


def test_value_and_gradient_are_those_of_the_formula():
    rng = np.random.default_rng(0)
    shapes = [(5, HIDDEN), (AGENTS, 3), (AGENTS, 3), (AGENTS, AGENTS, 2), (HIDDEN, OUTPUTS)]
    arguments = [rng.normal(size=shape).astype(np.float32) for shape in (*shapes, (OUTPUTS,))]
    weights = rng.normal(size=(AGENTS, OUTPUTS))

    def derive(function):
        def total(*arguments):
            value = function(*arguments)
            return (weights * value).sum(), value

        return jax.jit(jax.grad(total, argnums=range(6), has_aux=True))(*arguments)

    (found, value), (wanted, plain) = derive(pooled), derive(plainly)
    assert 0 < (np.asarray(plain) == 0).sum() < plain.size  # Shut outputs are among them.
    assert_allclose(value, plain, atol=1e-6)
    for one, other in zip(found, wanted):
        assert np.abs(other).max() > 0.1
        assert_allclose(one, other, atol=1e-5)
