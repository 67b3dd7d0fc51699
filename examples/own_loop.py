"""Your arrays, your loss, optax: train a network and the weights of its symbols in plain JAX.

python examples/own_loop.py [STEPS]
"""

import dataclasses
import functools
import sys

import jax
import jax.numpy as jnp
import numpy as np
import optax

import neurosym_jax as nj

steps = int(sys.argv[1]) if len(sys.argv) > 1 else 200
model = nj.load_model("neurosym_simulations_8")
config = dataclasses.replace(model.config, weighting=nj.symbolic.Learned())
params = {**model.params, "weighting": nj.symbolic.initial_parameters(config.weighting)}

rng = np.random.default_rng(0)
velocity = rng.normal(0, 0.3, (64, 4, 1, 2)) + rng.normal(0, 0.03, (64, 4, 16, 2))
walks = rng.uniform(-3, 3, (64, 4, 1, 2)) + np.cumsum(velocity, axis=2)
# [scenes, people, 8, 2] metres
observed, future = np.split(walks.astype(np.float32), 2, axis=2)


def loss(params, key):
    """Mean over scenes of the best of 5 joint ADE."""
    noise = jax.random.normal(key, (len(observed), 5, config.noise_dim))
    forecast = functools.partial(nj.forecast, config, params)  # [5, people, 8, 2]
    futures = jax.vmap(forecast)(observed, noise)
    error = jnp.linalg.norm(futures - future[:, None], axis=-1).mean((2, 3))
    return error.min(1).mean()


@jax.jit
def step(params, state, key):
    """One update; also returns the loss and its gradient by the weights of the 81 states."""
    value, gradient = jax.value_and_grad(loss)(params, key)
    updates, state = optimizer.update(gradient, state)
    params = optax.apply_updates(params, updates)
    return params, state, value, gradient["weighting"]["table"]


optimizer = optax.adam(1e-3)
state = optimizer.init(params)
for number in range(steps):
    params, state, value, slopes = step(params, state, jax.random.key(number))
    if number in (0, steps - 1):
        most = abs(slopes).argmax()
        print(
            f"step {number}: {value:.3f} m; by the weight of state {most}: {slopes[most]:+.4f}"
        )
