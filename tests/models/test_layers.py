import jax
import numpy as np
import pytest

from neurosym_jax.models.layers import Affine


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
