import jax
import numpy as np
from numpy.testing import assert_allclose

from neurosym_jax.models.cell import LSTM, Encoder, LSTMNetwork


def sigmoid(x):
    return 1 / (1 + np.exp(-x))


def torch_lstm(inputs, parameters):
    """Hidden states [T, H] of torch's LSTM from zeros, `inputs [T, D]`, in numpy."""
    size = parameters["recurrent_kernel"].shape[0]
    hidden, cell, states = np.zeros(size), np.zeros(size), []
    for x in inputs:
        gates = (
            x @ parameters["input_kernel"]
            + parameters["input_bias"]
            + hidden @ parameters["recurrent_kernel"]
            + parameters["recurrent_bias"]
        )
        i, f, g, o = (gates[part * size : (part + 1) * size] for part in range(4))
        cell = sigmoid(f) * cell + sigmoid(i) * np.tanh(g)
        hidden = sigmoid(o) * np.tanh(cell)
        states.append(hidden)
    return np.array(states)


def random_like(tree, seed=0, scale=0.4):
    rng = np.random.default_rng(seed)
    return jax.tree.map(lambda leaf: rng.normal(0, scale, leaf.shape).astype(np.float32), tree)


def test_encoder_against_a_loop():
    steps = np.random.default_rng(1).normal(0, 0.4, (3, 8, 2)).astype(np.float32)
    module = Encoder(LSTM(), embedding_dim=5, h_dim=7)
    params = random_like(jax.eval_shape(module.init, jax.random.key(0), steps))
    embedding, lstm = params["params"]["spatial_embedding"], params["params"]["lstm"]
    wanted = [
        torch_lstm(agent @ embedding["kernel"] + embedding["bias"], lstm)[-1] for agent in steps
    ]
    assert_allclose(module.apply(params, steps), wanted, atol=1e-6)


def test_initialised_as_torch_does():
    module = LSTMNetwork(inputs=16, features=64)
    params = module.init(jax.random.key(0), method=lambda lstm: lstm.input_bias)["params"]
    shapes = {name: leaf.shape for name, leaf in params.items()}
    assert shapes == {
        "input_kernel": (16, 256),
        "recurrent_kernel": (64, 256),
        "input_bias": (256,),
        "recurrent_bias": (256,),
    }
    bound = 64**-0.5
    for leaf in params.values():
        assert np.abs(leaf).max() <= bound
        assert np.abs(leaf).max() > 0.95 * bound
        assert abs(np.std(leaf) - bound / 3**0.5) < 0.1 * bound
    # Two biases with values of their own.
    assert np.abs(params["input_bias"] - params["recurrent_bias"]).max() > 0.1 * bound
