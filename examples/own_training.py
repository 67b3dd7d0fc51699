"""Train with a loss, an optimiser and an annealed temperature of your own: docs/extend.md."""

import jax.numpy as jnp
import optax

import neurosym_jax as nj


def worst_step(forecast, scene):
    """Largest error of each sample at any step, of the best sample; metres."""
    error = jnp.linalg.norm(forecast - scene.known_future + 1e-9, axis=-1)
    error = jnp.where(scene.valid[None, :, None], error, 0)
    return error.max(axis=2).mean(axis=1).min()


def sharper(step):
    """A temperature of the soft symbols that falls from 0.2 to 0.02 m/s in 300 steps."""
    return jnp.log(0.2) + jnp.minimum(step / 300, 1) * jnp.log(0.1)


def main(folder="runs/own_training", steps=50):
    """Train NeuroSyM on a simulated walk; returns the model."""
    return nj.train(
        nj.data.on_grid(nj.simulation.simulate("cross-path", 0), 0.4),
        config=nj.training.make_config(
            "neurosym", changes=["weighting=soft,learned=true"]
        ),
        recipe=nj.training.make_recipe("ours", steps=steps),
        folder=folder,
        loss=worst_step,
        optimizer=optax.contrib.prodigy(1.0),
        schedule={"weighting.log_temperature": sharper},
    )


if __name__ == "__main__":
    print(main())
