"""Networks against the same networks step by step, with nothing folded and nothing shared."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose

from neurosym_jax.models import Discriminator, Generator
from neurosym_jax.models.anchors.network import AnchorConfig, AnchorNetwork
from neurosym_jax.models.sgan import network
from neurosym_jax.models.sgan.forecaster import GeneratorForecaster
from neurosym_jax.models.sgan.network import (
    LSTM,
    Affine,
    DiscriminatorConfig,
    Encoder,
    GeneratorConfig,
    LSTMNetwork,
    Perceptron,
    PoolNetwork,
    pooling_network,
)
from neurosym_jax.scene import make_scene
from neurosym_jax.symbolic import make_weighting
from tests.networks import random_params
from tests.registrations import restored_registrations

with restored_registrations():
    from tests.models.network_plugin import RNN  # Registered in these tests alone.

CONFIGS = {
    "pool_net": GeneratorConfig(pooling="pool_net,hidden_dim=16", pred_len=4),
    "none": GeneratorConfig(pooling="none", pred_len=4),
    "bare": GeneratorConfig(pooling="none", noise_dim=0, pred_len=4),
    "social": GeneratorConfig(pooling="social,grid_size=4", pred_len=4),
    "every step": GeneratorConfig(
        pool_every_timestep=True,
        pooling="pool_net,hidden_dim=16",
        decoder_h_dim=40,
        pred_len=4,
    ),
    "symbols, every step": GeneratorConfig(
        pooling="as_described,hidden_dim=16",
        pool_every_timestep=True,
        obs_len=5,
        pred_len=7,
        weighting="quantised",
    ),
    "bare, wider": GeneratorConfig(
        pooling="none", noise_dim=0, pred_len=4, decoder_h_dim=40
    ),
    "rnn": GeneratorConfig(pooling="none", noise_dim=0, pred_len=4, cell=RNN()),
    "one step": GeneratorConfig(
        pooling="pool_net,hidden_dim=16", pred_len=1, obs_len=1
    ),
}
EACH = pytest.mark.parametrize("config", CONFIGS.values(), ids=list(CONFIGS))


def example(config, agents=5):
    rng = np.random.default_rng(0)
    return make_scene(rng.normal(0, 0.4, (agents, config.obs_len, 2)).cumsum(axis=1))


def weights_of(config, scene):
    """Alpha of what was observed, and what gives that of predicted steps."""
    if not config.symbolic:
        return ()
    alpha = weighed(config)(scene.observed, scene.valid)
    return alpha, make_weighting(config.weighting)


@functools.cache
def weighed(config):
    """The weighting of a network as one program."""
    return jax.jit(make_weighting(config.weighting))


@functools.cache
def pooled_by(config, width):
    """The pooling of hidden states of this width as one program."""
    return jax.jit(pooling_network(config, width).apply)


@functools.cache
def perceptron(*sizes):
    """A perceptron as one program."""
    return jax.jit(Perceptron(sizes).apply)


def sigmoid(x):
    return 1 / (1 + np.exp(-x))


def dense(x, layer):
    return x @ layer["kernel"] + layer["bias"]


def stepped(part, state, x):
    """The state (hidden, cell) after a displacement x, in the encoder or decoder `part`."""
    embedded = dense(x, part["spatial_embedding"])
    if "rnn" in part:
        rnn = part["rnn"]
        gate = (
            embedded @ rnn["input_kernel"]
            + state[0] @ rnn["recurrent_kernel"]
            + rnn["bias"]
        )
        return np.tanh(gate), state[1]
    hidden, cell = state
    lstm = part["lstm"]
    gates = embedded @ lstm["input_kernel"] + lstm["input_bias"]
    gates = gates + hidden @ lstm["recurrent_kernel"] + lstm["recurrent_bias"]
    i, f, g, o = np.split(gates, 4, axis=1)
    cell = sigmoid(f) * cell + sigmoid(i) * np.tanh(g)
    return sigmoid(o) * np.tanh(cell), cell


def unfolded(config, params, scene, noise):
    """The generator step by step as SGAN's code has it."""
    params = params["params"]
    observed = np.asarray(scene.observed)
    state = (np.zeros((len(observed), config.encoder_h_dim)),) * 2
    for step in np.moveaxis(np.asarray(scene.displacement), 1, 0):
        state = stepped(params["encoder"], state, step)
    context = state[0]

    def pool(params, hidden, track):
        """Pool the positions so far: NeuroSyM sees as many of them as it observes."""
        window = track[:, -config.obs_len :]
        available = {"hidden": hidden, "position": window[:, -1], "track": window}
        if config.symbolic:
            available["alpha"] = weighed(config)(window)
        seen = {name: available[name] for name in config.pooling.inputs}
        apply = pooled_by(config, hidden.shape[1])
        return apply({"params": params}, valid=scene.valid, **seen)

    if config.pools:
        pooled = pool(params["pooling"], context, observed)
        context = np.concatenate([context, pooled], axis=1)
    if "context_mlp" in params:
        width = config.decoder_h_dim - config.noise_dim
        apply = perceptron(context.shape[1], config.mlp_dim, width)
        context = apply({"params": params["context_mlp"]}, context)
    noises = np.broadcast_to(noise, (len(observed), config.noise_dim))
    hidden = np.concatenate([context, noises], axis=1)
    cell = np.zeros_like(hidden)
    decoder = params["decoder"]
    track, step = observed, np.asarray(scene.displacement)[:, -1]
    steps = []
    for _ in range(config.pred_len):
        hidden, cell = stepped(decoder, (hidden, cell), step)
        step = dense(hidden, decoder["hidden2pos"])
        track = np.concatenate([track, track[:, -1:] + step[:, None]], axis=1)
        steps.append(step)
        if config.pool_every_timestep:
            pooled = pool(decoder["pooling"], hidden, track)
            joined = np.concatenate([hidden, pooled], axis=1)
            apply = perceptron(joined.shape[1], config.mlp_dim, config.decoder_h_dim)
            hidden = np.asarray(apply({"params": decoder["mlp"]}, joined))
    return np.stack(steps, axis=1)


def test_the_state_is_about_as_large_as_measured():
    """360 numbers a person and sample: what a forecast's memory is estimated by."""
    assert 340 < GeneratorForecaster(GeneratorConfig()).state_size < 380


@EACH
def test_against_the_unfolded_chain(config):
    scene = example(config)
    noise = np.random.default_rng(2).normal(size=config.noise_dim).astype(np.float32)
    params = random_params(Generator(config), scene, noise, *weights_of(config, scene))
    forecast = jax.jit(
        lambda params: Generator(config).apply(
            params, scene, noise, *weights_of(config, scene)
        )
    )(params)
    assert forecast.shape == (5, config.pred_len, 2)
    expected = unfolded(config, params, scene, noise)
    assert_allclose(forecast, expected, atol=1e-5)
    assert np.abs(expected).max() > 0.05
    same_size = config.encoder_h_dim == config.decoder_h_dim
    bare = same_size and not config.pools and not config.noise_dim
    assert ("context_mlp" in params["params"]) == (not bare)


def test_default_networks_have_the_published_sizes():
    """Numbers of parameters: SGAN's generator as in its checkpoints, anchors as recommended."""
    scene, noise = example(GeneratorConfig()), np.zeros(8)
    trajectory = (scene.observed, scene.displacement, scene.valid)
    for module, inputs, size in (
        (Generator(GeneratorConfig()), (scene, noise), 46_386),
        (Discriminator(DiscriminatorConfig()), trajectory, 73_873),
        (AnchorNetwork(AnchorConfig()), (scene.observed, scene.valid), 40_271),
    ):
        shapes = jax.eval_shape(module.init, jax.random.key(0), *inputs)
        assert sum(leaf.size for leaf in jax.tree.leaves(shapes)) == size


@pytest.mark.parametrize("kind", ["global", "local"])
def test_discriminator(kind):
    config = DiscriminatorConfig(kind=kind, pool_hidden_dim=16)
    scene = example(GeneratorConfig())
    trajectory = (scene.observed, scene.displacement, scene.valid)
    params = random_params(Discriminator(config), *trajectory)
    bias = params["params"]["classifier"]["layer_1"]["bias"]
    # So that scores live.
    params["params"]["classifier"]["layer_1"]["bias"] = bias * 0 + 3
    apply = jax.jit(Discriminator(config).apply)
    scores = np.asarray(apply(params, *trajectory))
    parts = params["params"]
    encoder = Encoder(LSTM(), config.embedding_dim, config.h_dim)
    expected = jax.jit(encoder.apply)({"params": parts["encoder"]}, scene.displacement)
    if kind == "global":
        pooling = PoolNetwork(config.embedding_dim, config.h_dim, 16, config.h_dim)
        inputs = expected, scene.observed[:, 0], scene.valid
        expected = jax.jit(pooling.apply)({"params": parts["pooling"]}, *inputs)
    for layer in ("layer_0", "layer_1"):
        expected = np.maximum(dense(expected, parts["classifier"][layer]), 0)
    assert_allclose(scores, expected[:, 0], atol=1e-5)
    assert scores.min() > 0
    padded = [
        np.pad(part, [(0, 3)] + [(0, 0)] * (part.ndim - 1)) for part in trajectory
    ]
    assert_allclose(apply(params, *padded)[:5], scores, atol=1e-5)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["tanh", "sigmoid"])
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_tanh_and_sigmoid(name, dtype):
    """They and two derivatives, forward and backward, equal the exact functions up to rounding."""
    x, function = np.linspace(-30, 30, 60_001), getattr(network, name)
    y = np.tanh(x) if name == "tanh" else sigmoid(x)
    first, second = 1 - y * y, -2 * y * (1 - y * y)
    if name == "sigmoid":
        first, second = y * (1 - y), y * (1 - y) * (1 - 2 * y)
    with jax.enable_x64(dtype is np.float64):
        for atol, exact, backward, forward in (
            (3e-7, y, function, function),
            (6e-7, first, jax.grad(function), jax.jacfwd(function)),
            (12e-7, second, jax.grad(jax.grad(function)), jax.hessian(function)),
        ):
            for derivative in (backward, forward):
                values = jax.jit(jax.vmap(derivative))(x.astype(dtype))
                assert values.dtype == dtype
                atol = 1e-14 if dtype is np.float64 else atol
                assert_allclose(values, exact, rtol=0, atol=atol)
        with jax.debug_nans(False):
            limits = function(jnp.asarray([-np.inf, np.inf, np.nan], dtype))
        assert_allclose(limits, [y[0], y[-1], np.nan], atol=2e-7)


def test_initialised_as_torch_does():
    """As in SGAN: Kaiming normal, not cut off, and no gain but that of ReLU."""
    module = LSTMNetwork(inputs=16, features=64)
    init = jax.jit(lambda key: module.init(key, method=lambda lstm: lstm.input_bias))
    params = jax.tree.map(np.asarray, init(jax.random.key(0))["params"])
    kernels = {"input_kernel": (16, 256), "recurrent_kernel": (64, 256)}
    biases = {"input_bias": (256,), "recurrent_bias": (256,)}
    assert {name: leaf.shape for name, leaf in params.items()} == kernels | biases
    # Two biases with values of their own.
    assert np.abs(params["input_bias"] - params["recurrent_bias"]).max() > 0.0125
    uniform = [(leaf, 64) for leaf in params.values()]
    for inputs in (2, 40, 512):
        init = jax.jit(Affine(inputs, 400).init)
        layer = init(jax.random.key(1), np.zeros(inputs, np.float32))["params"]
        layer = jax.tree.map(np.asarray, layer)
        assert layer["kernel"].shape == (inputs, 400)
        assert abs(np.std(layer["kernel"]) * (inputs / 2) ** 0.5 - 1) < 0.1
        assert np.abs(layer["kernel"]).max() > 2.5 * np.std(layer["kernel"])
        uniform.append((layer["bias"], inputs))
    for leaf, inputs in uniform:
        scaled = leaf * inputs**0.5
        assert 0.95 < np.abs(scaled).max() <= 1 + 1e-6
        assert abs(np.std(scaled) - 3**-0.5) < 0.1
        assert abs(np.mean(scaled)) < 0.15
