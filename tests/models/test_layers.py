import jax
import numpy as np
import pytest
from numpy.testing import assert_allclose

from neurosym_jax.models.layers import Affine, Perceptron


@pytest.mark.parametrize("inputs", [2, 40, 512])
def test_affine_is_initialised_as_sgan_does(inputs):
    params = Affine(inputs, 400).init(jax.random.key(1), np.zeros(inputs))["params"]
    kernel, bias = params["kernel"], params["bias"]
    assert kernel.shape == (inputs, 400)
    # Kaiming normal: not cut off, and no gain but ReLU's.
    assert abs(np.std(kernel) * (inputs / 2) ** 0.5 - 1) < 0.1
    assert np.abs(kernel).max() > 2.5 * np.std(kernel)
    bound = inputs**-0.5
    assert 0.95 * bound < np.abs(bias).max() <= bound
    assert abs(np.mean(bias)) < 0.15 * bound


def test_the_last_relu_too():
    module = Perceptron((3, 4, 2))
    x = np.random.default_rng(0).normal(size=(50, 3)).astype(np.float32)
    params = module.init(jax.random.key(0), x)
    first, second = (params["params"][f"layer_{n}"] for n in (0, 1))
    hidden = np.maximum(x @ first["kernel"] + first["bias"], 0)
    wanted = np.maximum(hidden @ second["kernel"] + second["bias"], 0)
    out = module.apply(params, x)
    assert_allclose(out, wanted, atol=1e-6)
    assert (wanted == 0).any()
