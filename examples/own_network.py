"""A Flax network of your own that pools neighbours by soft symbols and alpha.

python examples/own_network.py [STEPS]    # by default 100; it prints

0.462 m, constant velocity 0.968 m
a movement below 0.137 m/s counts as none
"""

import sys

import flax.linen as nn
import jax
import jax.numpy as jnp
import numpy as np
import optax

import neurosym_jax as nj
from neurosym_jax.symbolic import make_weighting, soft_symbols


class Network(nn.Module):
    """Positions [N, 8, 2] of the next 3.2 s, from observed [N, 8, 2] metres and valid [N]."""

    @nn.compact
    def __call__(self, observed, valid):
        """[N, 8, 2] metres: constant velocity and what the network adds."""
        start = nn.initializers.constant(np.log(0.125))
        speed = jnp.exp(self.param("log_speed", start, ()))
        pairs, step = (observed[:, None], observed[None]), 0.4 * speed  # metres a step
        symbols = soft_symbols(*pairs, temperature=0.02, quantisation_factor=step)
        last = symbols[:, :, -1]
        signs = last[..., 2] - last[..., 0]  # [N, N, 4]: expected q1 to q4
        offset = observed[None, :, -1] - observed[:, None, -1]
        message = nn.relu(nn.Dense(32)(jnp.concatenate([signs, offset], -1)))
        alpha = make_weighting("quantised", period=0.4)(observed, valid)[:, :, -1:]
        others = valid[None] & ~jnp.eye(valid.shape[0], dtype=bool)
        heard = (alpha * message * others[..., None]).sum(1)
        steps = jnp.diff(observed, axis=1)
        history = steps.reshape(len(steps), -1)
        own = jnp.concatenate([history, observed[:, -1], heard], -1)
        bend = nn.Dense(16)(nn.relu(nn.Dense(64)(own))).reshape(-1, 8, 2)
        return observed[:, -1:] + steps[:, -1:] * np.arange(1, 9)[:, None] + bend


def scenes(seed):
    """All windows of a simulated recording as one Scene with a leading axis."""
    tracks = nj.data.on_grid(nj.simulation.simulate("cross-path", seed), 0.4)
    windows = nj.data.cut_windows([tracks], obs_len=8, pred_len=8, skip=16)
    return nj.data.make_batches(windows, slots=2048)[0].scene


@jax.jit
def loss(params, scene):
    """Mean distance from the truth, metres."""
    apply = jax.vmap(network.apply, (None, 0, 0))
    forecast = apply(params, scene.observed, scene.valid)
    error = jnp.linalg.norm(forecast - scene.future + 1e-9, axis=-1).mean(-1)
    return (error * scene.valid).sum() / scene.valid.sum()


@jax.jit
def step(params, state, scene):
    """One update."""
    updates, state = optimizer.update(jax.grad(loss)(params, scene), state)
    return optax.apply_updates(params, updates), state


steps = int(sys.argv[1]) if len(sys.argv) > 1 else 100
network, optimizer = Network(), optax.adam(1e-2)
training, test = [scenes(0), scenes(1)], scenes(9)
params = jax.jit(network.init)(jax.random.key(0), test.observed[0], test.valid[0])
state, straight = optimizer.init(params), jax.tree.map(jnp.zeros_like, params)
for number in range(steps):
    params, state = step(params, state, training[number % 2])
speed = float(jnp.exp(params["params"]["log_speed"]))
print(f"{loss(params, test):.3f} m, constant velocity {loss(straight, test):.3f} m")
print(f"a movement below {speed:.3f} m/s counts as none")
