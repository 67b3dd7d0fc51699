"""Every family's forecast, and its gradient, under each of JAX's transforms; see docs/extend.md."""

import os
import subprocess
import sys
from pathlib import Path

import jax
import jax.export
import jax.numpy as jnp
import numpy as np
import pytest
from jax.experimental import checkify
from jax.sharding import AbstractMesh, AxisType, NamedSharding, PartitionSpec

import neurosym_jax as nj
from tests.models.test_strict import CONFIGS, WALKS, noise_of
from tests.networks import random_model
from tests.repository import exhaustive

SCENES = np.stack([WALKS, WALKS + 1.0])
SPLIT = PartitionSpec("scenes")


def problem(name):
    """The loss of one scene, its gradient by parameters and positions, and parameters."""
    model = random_model(CONFIGS[name])
    noise = noise_of(model)
    params = jax.tree.map(jnp.asarray, model.params)

    def loss(params, observed):
        return jnp.square(nj.forecast(model.config, params, observed, noise)).sum()

    def both(params, observed):
        return loss(params, observed), jax.grad(loss, argnums=(0, 1))(params, observed)

    return loss, both, params


def vmap(loss, both, params):
    """Scenes along a leading axis."""
    return jax.eval_shape(jax.vmap(both, in_axes=(None, 0)), params, SCENES)


def vmap_of_seeds(loss, both, params):
    """Networks along a leading axis."""
    stacked = jax.tree.map(lambda leaf: jnp.stack([leaf, leaf]), params)
    return jax.eval_shape(jax.vmap(both, in_axes=(0, None)), stacked, SCENES[0])


def hvp(loss, both, params):
    """A Hessian times a vector, forward over reverse and reverse over reverse."""
    ones = jax.tree.map(jnp.ones_like, params)
    slope = jax.grad(loss)

    def along(params, observed):
        return jax.tree.reduce(
            jnp.add, jax.tree.map(jnp.vdot, slope(params, observed), ones)
        )

    def products(params, observed):
        forward = jax.jvp(lambda params: slope(params, observed), (params,), (ones,))
        return forward[1], jax.grad(along)(params, observed)

    return jax.eval_shape(products, params, SCENES[0])


def remat(loss, both, params):
    """Values computed again in the backward pass."""
    return jax.eval_shape(jax.grad(jax.remat(loss)), params, SCENES[0])


def checkified(loss, both, params):
    """NaN and division by zero reported as errors."""
    checked = checkify.checkify(both, errors=checkify.float_checks)
    return jax.eval_shape(checked, params, SCENES[0])


def export(loss, both, params):
    """A program for any number of scenes and people."""
    shape = jax.export.symbolic_shape("scenes, people, 4, 2")
    observed = jax.ShapeDtypeStruct(shape, np.float32)
    program = jax.jit(jax.vmap(both, in_axes=(None, 0)))
    return jax.export.export(program)(params, observed)


def sharded(loss, both, params):
    """Scenes on two devices by `jax.shard_map`, parameters on both."""
    mesh = AbstractMesh((2,), ("scenes",), axis_types=(AxisType.Auto,))
    mapped = jax.vmap(both, in_axes=(None, 0))
    parts = (PartitionSpec(), SPLIT)
    program = jax.shard_map(mapped, mesh=mesh, in_specs=parts, out_specs=SPLIT)
    return jax.eval_shape(program, params, SCENES)


def explicit_mesh(loss, both, params):
    """Scenes on two devices by the types of `jax.make_mesh`."""
    mesh = AbstractMesh((2,), ("scenes",), axis_types=(AxisType.Explicit,))
    sharding = NamedSharding(mesh, SPLIT)
    observed = jax.ShapeDtypeStruct(SCENES.shape, np.float32, sharding=sharding)
    with jax.sharding.use_abstract_mesh(mesh):
        program = jax.jit(jax.vmap(both, in_axes=(None, 0)))
        result = program.trace(params, observed).out_info
    assert result[0].sharding.spec == SPLIT
    return result


def mixed_precision(loss, both, params):
    """Parameters and positions of bfloat16, whose gradients are of their types."""
    half = jax.tree.map(lambda leaf: leaf.astype(jnp.bfloat16), params)
    observed = SCENES[0].astype(jnp.bfloat16)
    result = jax.eval_shape(both, half, observed)
    assert {leaf.dtype for leaf in jax.tree.leaves(result[1])} == {
        np.dtype(jnp.bfloat16)
    }
    return result


TRANSFORMS = {
    "vmap over scenes": vmap,
    "vmap over networks": vmap_of_seeds,
    "Hessian-vector products": hvp,
    "remat": remat,
    "checkify": checkified,
    "jax.export": export,
    "shard_map": sharded,
    "Explicit mesh": explicit_mesh,
    "bfloat16": mixed_precision,
}


REFUSED = {("anchor table", "Explicit mesh"), ("NeuroSyM, every step", "Explicit mesh")}
"""jax 0.10 transposes the broadcast of a scalar parameter without its mesh; docs/extend.md says so."""


def pairs():
    """Families and transforms; by default each family and each transform once, and a refusal."""
    cases = []
    for row, name in enumerate(CONFIGS):
        for column, transform in enumerate(TRANSFORMS):
            chosen = row % len(TRANSFORMS) == column
            chosen |= (name, transform) == ("anchor table", "Explicit mesh")
            cases.append((name, transform) if chosen else exhaustive(name, transform))
    return cases


@pytest.mark.parametrize(("name", "transform"), pairs())
def test_every_family_under(name, transform):
    if (name, transform) in REFUSED:
        with pytest.raises(ValueError, match="is not found in mesh"):
            TRANSFORMS[transform](*problem(name))
    else:
        TRANSFORMS[transform](*problem(name))


def test_the_page_names_these_transforms():
    page = Path(__file__).parents[2].joinpath("docs", "extend.md").read_text()
    section = page.split("\n### Transforms")[1].split("\n### ")[0]
    for transform in TRANSFORMS:
        assert transform in section.replace("`", "")


TWO_DEVICES = """
import jax, numpy as np
from jax.sharding import AxisType, PartitionSpec as P
from tests.models.test_transforms import SCENES, problem

loss, both, params = problem("NeuroSyM, soft")

def total(params, scenes):
    values = jax.vmap(loss, in_axes=(None, 0))(params, scenes)
    return values.sum(), values

# The gradient of what is on both devices is the sum over them.
slopes = jax.grad(total, argnums=(0, 1), has_aux=True)
mesh = jax.make_mesh((2,), ("scenes",), axis_types=(AxisType.Auto,))
parts = dict(in_specs=(P(), P("scenes")), out_specs=((P(), P("scenes")), P("scenes")))
halves = jax.jit(jax.shard_map(slopes, mesh=mesh, **parts))(params, SCENES)
assert len(halves[1].devices()) == 2
assert all(np.any(leaf) for leaf in jax.tree.leaves(halves[0][0]["weighting"]))
jax.tree.map(
    lambda a, b: np.testing.assert_allclose(a, b, rtol=1e-4, atol=1e-4),
    halves, jax.jit(slopes)(params, SCENES),
)
"""


MEAN_OVER_DEVICES = """
def mean(params, scenes):
    return jax.vmap(loss, in_axes=(None, 0))(params, scenes).mean()

def mean_over_devices(params, scenes):
    return jax.lax.pmean(mean(params, scenes), "scenes")

parts = dict(in_specs=(P(), P("scenes")), out_specs=P())
whole = jax.shard_map(mean_over_devices, mesh=mesh, **parts)
jax.tree.map(
    lambda a, b: np.testing.assert_allclose(a, b, rtol=1e-4, atol=1e-4),
    jax.jit(jax.grad(whole))(params, SCENES), jax.jit(jax.grad(mean))(params, SCENES),
)
"""


@pytest.mark.slow
def test_two_devices_give_the_numbers_of_one():
    """Also that the gradient of a shared parameter is the sum over devices, as the page says."""
    flags = os.environ.get("XLA_FLAGS", "")
    flags += " --xla_force_host_platform_device_count=2"
    environment = {**os.environ, "XLA_FLAGS": flags, "JAX_PLATFORMS": "cpu"}
    code = TWO_DEVICES + MEAN_OVER_DEVICES
    subprocess.run([sys.executable, "-c", code], env=environment, check=True)
