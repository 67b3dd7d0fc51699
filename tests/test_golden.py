"""Forecasts of every shipped model on three small scenes, as they were when it shipped.

`python -m tests.test_golden` writes them again, for a model that is new or meant to be
another.
"""

import numpy as np
import pytest

from neurosym_jax.models.disk import load_model, shipped_models
from neurosym_jax.models.forecast import predict_scenes
from neurosym_jax.models.sgan.network import GeneratorConfig
from tests.networks import random_model
from tests.repository import GOLDEN, exhaustive

STORED = GOLDEN / "forecasts.npz"
UNIT = 1e-5  # metres
SAMPLES = [0, 7, 19]
SIZES = (1, 3, 5)
"""People in each scene."""
SHIPPED = {path.name: path for path in shipped_models()}
RANDOM = {
    "every step": GeneratorConfig(
        pooling="as_described,hidden_dim=16", pool_every_timestep=True, weighting="soft"
    ),
}
"""Networks that do not ship, with weights drawn by numpy."""


def forecasts(name, observed):
    """Three samples `[3, 9, T, 2]` of the people of all scenes."""
    model = random_model(RANDOM[name]) if name in RANDOM else load_model(SHIPPED[name])
    scenes = np.split(observed, np.cumsum(SIZES)[:-1])
    return np.concatenate(predict_scenes(model, scenes, samples=20, seed=0), axis=1)[
        SAMPLES
    ]


@pytest.mark.parametrize("name", [*map(exhaustive, RANDOM), *SHIPPED])
def test_forecasts_are_those_that_are_stored(name):
    with np.load(STORED) as stored:
        expected = UNIT * stored[name]
        forecast = forecasts(name, stored["observed"])
    np.testing.assert_allclose(forecast, expected, rtol=0, atol=1e-4)
    assert np.linalg.norm(np.diff(forecast, axis=0), axis=-1).max() > 0.1


def write():
    """People at 0 to 1.3 m/s within a few metres, the last of each scene at rest."""
    draw = np.random.default_rng(30)
    speed = draw.uniform(0, 1.3, (sum(SIZES), 1, 1)) * 0.4
    angle = draw.uniform(0, 2 * np.pi, (sum(SIZES), 1)) + draw.normal(
        0, 0.1, (sum(SIZES), 8)
    )
    steps = speed * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    steps[np.cumsum(SIZES)[1:] - 1] = 0
    observed = draw.uniform(-2, 2, (sum(SIZES), 1, 2)) + np.cumsum(steps, axis=1)
    observed = observed.round(3)
    units = {name: forecasts(name, observed) / UNIT for name in (*RANDOM, *SHIPPED)}
    rounded = {name: values.round().astype(np.int32) for name, values in units.items()}
    np.savez_compressed(STORED, observed=observed, **rounded)


if __name__ == "__main__":
    write()
