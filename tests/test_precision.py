"""Products of matrices keep all bits of float32: a GPU's default moves forecasts by millimetres.

What is traced says so on a CPU, too. `python -m benchmarks --gpu` runs the tests of
numbers on a GPU.
"""

import dataclasses
import functools
from collections.abc import Iterator
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import neurosym_jax as nj
from neurosym_jax.configuration import component
from neurosym_jax.data import Windows
from neurosym_jax.evaluation.metrics import METRICS
from neurosym_jax.models.forecaster import forecaster_of
from neurosym_jax.models.place.memory import Recall
from neurosym_jax.models.place.mixture import distances_apart, errors, remembered
from neurosym_jax.runtime.programs import program
from neurosym_jax.symbolic.weighting import WEIGHTINGS, initial_parameters
from neurosym_jax.training.run import recipes_of
from tests.models.test_strict import CONFIGS, WALKS
from tests.models.test_transforms import problem
from tests.networks import random_model

ALL_BITS = {"(Precision.HIGHEST, Precision.HIGHEST)"}


def precisions(function, *arguments) -> set[str]:
    """Which precisions the products of a traced function ask for."""
    traced = jax.make_jaxpr(function)(*arguments)
    return {
        str(equation.params["precision"])
        for equation in equations(traced.jaxpr)
        if equation.primitive.name == "dot_general"
    }


def equations(jaxpr) -> Iterator[Any]:
    """Those of a program, and of all programs within it."""
    for equation in jaxpr.eqns:
        yield equation
        for value in jax.tree.leaves(list(equation.params.values())):
            inner = getattr(value, "jaxpr", value)
            if hasattr(inner, "eqns"):
                yield from equations(inner)


QUICK = ("social pooling", "NeuroSyM, soft", "anchors")


def families() -> list[Any]:
    """Three by default, all of them where slow tests run."""
    slow = pytest.mark.slow
    return [
        name if name in QUICK else pytest.param(name, marks=slow) for name in CONFIGS
    ]


@pytest.mark.parametrize("name", families())
def test_a_forecast_and_its_gradient(name):
    _, both, params = problem(name)
    assert precisions(both, params, WALKS) == ALL_BITS


@pytest.mark.parametrize("name", families())
def test_a_distribution(name):
    model = random_model(CONFIGS[name])
    scene = nj.make_scene(WALKS)

    def draws(params):
        return model.forecaster.distribution(params, scene, jax.random.key(0), 4)

    assert precisions(draws, model.params) <= ALL_BITS


@pytest.mark.slow
@pytest.mark.parametrize("name", ["SGAN", "NeuroSyM", "anchors", "anchor table"])
def test_a_training_step(name):
    forecaster = forecaster_of(CONFIGS[name])
    recipe = next(iter(recipes_of(type(forecaster)).values()))
    recipe = dataclasses.replace(recipe, batch_scenes=2, rotate=1.0)
    if hasattr(recipe, "adversarial_weight"):
        recipe = dataclasses.replace(recipe, adversarial_weight=1.0, best_k=2)
    position = np.concatenate([WALKS, WALKS[:, :3] + 1], axis=1).astype(np.float64)
    identity = np.zeros((1, 2), np.uint32)
    windows = Windows(position, np.arange(3), np.array([0, 3]), identity, 4)
    advance = forecaster.rounds(windows, recipe, jax.random.key(1))
    state = jax.eval_shape(lambda: forecaster.init_state(recipe, jax.random.key(0)))
    assert precisions(lambda state: advance(state, 0, 1), state) == ALL_BITS


def test_metrics():
    futures = np.zeros((4, 3, 4, 2), np.float32)
    scene = nj.make_scene(WALKS, future=WALKS)
    for name, metric in METRICS.items():
        if metric.on_host:
            continue
        compute = functools.partial(metric.compute, scene=scene)
        if metric.weighted:
            compute = functools.partial(compute, probability=None)
        assert precisions(compute, futures) <= ALL_BITS, name


@pytest.mark.parametrize(
    "name", ["soft", "soft,learned=true", "quantised,learned=true"]
)
def test_weights(name):
    weighting = component(name, WEIGHTINGS, "weighting")

    def total(learned, positions):
        return weighting.alpha(learned, positions).sum()

    slope = jax.value_and_grad(total, argnums=(0, 1))
    assert precisions(slope, initial_parameters(weighting), WALKS) <= ALL_BITS


def test_a_memory_of_a_place():
    people, ways, steps = 3, 5, 8
    onward = jnp.zeros((people, ways, steps, 2))
    weight = jnp.full((people, 1, ways), 1 / ways)
    recall = Recall(onward, weight, jnp.zeros(ways))
    offsets = jnp.zeros((4, people, steps, 2))
    shares = jnp.full((people, 2), 0.5)
    assert precisions(remembered, recall, shares, jnp.zeros((people, 2))) == ALL_BITS
    assert precisions(distances_apart, offsets, recall) == ALL_BITS
    assert precisions(errors, offsets, recall, onward[:, 0]) == ALL_BITS


def test_a_program_of_ours():
    @program()
    def product(matrix):
        return matrix @ matrix

    assert precisions(product, jnp.eye(2)) == ALL_BITS


def test_who_wants_fewer_bits_gets_them():
    _, both, params = problem("no pooling")
    with jax.default_matmul_precision("default"):
        assert not precisions(both, params, WALKS) & ALL_BITS
    with jax.default_matmul_precision("tensorfloat32"):
        assert precisions(both, params, WALKS) == {"(Precision.HIGH, Precision.HIGH)"}
    assert precisions(lambda matrix: matrix @ matrix, jnp.eye(2)) == {"None"}
