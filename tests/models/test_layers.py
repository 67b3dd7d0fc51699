import jax
import numpy as np
import pytest

from neurosym_jax.models.cell import LSTMNetwork
from neurosym_jax.models.layers import Affine


def test_initialised_as_torch_does():
    module = LSTMNetwork(inputs=16, features=64)
    params = module.init(jax.random.key(0), method=lambda lstm: lstm.input_bias)["params"]
    kernels = {"input_kernel": (16, 256), "recurrent_kernel": (64, 256)}
    biases = {"input_bias": (256,), "recurrent_bias": (256,)}
    assert {name: leaf.shape for name, leaf in params.items()} == kernels | biases
    bound = 64**-0.5
    for leaf in params.values():
        assert np.abs(leaf).max() <= bound
        assert np.abs(leaf).max() > 0.95 * bound
        assert abs(np.std(leaf) - bound / 3**0.5) < 0.1 * bound
    # Two biases with values of their own.
    assert np.abs(params["input_bias"] - params["recurrent_bias"]).max() > 0.1 * bound


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
