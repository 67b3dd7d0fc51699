"""A model as one StableHLO program for any number of people, which runs without this package.

The program maps `observed [n, obs_len, 2]` and `noise` to `(forecasts [k, n, pred_len, 2],
probabilities [k])`, in float32 metres and in the frame of `observed`. `noise` is [k, dim], or
[k, n, dim] for a model with noise for each agent; a model without noise takes `observed` alone. The
parameters are in the program and k is fixed, n is not. `jax.export.deserialize` runs it on a CPU or
a CUDA device.
"""

import jax.numpy as jnp
from jax import Array

from neurosym_jax.configuration import Count, refuse
from neurosym_jax.errors import InputError
from neurosym_jax.forecasting.model import Model
from neurosym_jax.scene import make_scene

__all__ = ["export_model"]


def export_model(model: Model, samples: int = 20) -> bytes:
    """The program of `model` with k = `samples`, serialised by `jax.export`.

    Subtract an origin near the people before a call: float32 resolves 4e-6 m at 100 m.

    Raises:
        InputError: for k that the model cannot make, a model that needs more than positions, and
            without flatbuffers.
    """
    import jax.export

    refuse(Count, {"samples": samples})
    forecaster, spec = model.forecaster, model.forecaster.noise
    samples = forecaster.count(samples)

    def program(observed: Array, noise: Array | None = None) -> tuple[Array, Array]:
        scene = make_scene(observed)
        noise = jnp.zeros((samples, 0)) if noise is None else noise
        forecasts, probabilities = forecaster.distribution(model.params, scene.bare(), noise)
        if probabilities is None:
            probabilities = jnp.full(samples, 1 / samples)
        return forecasts + jnp.asarray(scene.origin), probabilities

    sizes = [f"n, {model.config.obs_len}, 2"]
    if spec.dim:
        sizes += [f"{samples}, {'n, ' if spec.per_agent else ''}{spec.dim}"]
    scope = jax.export.SymbolicScope(("n >= 1",))
    given = (
        jax.ShapeDtypeStruct(jax.export.symbolic_shape(size, scope=scope), jnp.float32)
        for size in sizes
    )
    try:
        with jax.enable_x64(False):
            exported = jax.export.export(jax.jit(program), platforms=("cpu", "cuda"))(*given)
        return bytes(exported.serialize())
    except ImportError:
        raise InputError("exporting needs flatbuffers: pip install neurosym-jax[export]") from None
