import jax
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from neurosym_jax.models.forecaster import CHUNK, NoiseSpec, draw_noise, scene_noise

# Few shapes: each is a second of compiling.
GAUSSIAN, UNIFORM = NoiseSpec(2), NoiseSpec(1, per_agent=True, distribution="uniform")
SPECS = pytest.mark.parametrize(
    "spec", [GAUSSIAN, UNIFORM], ids=["gaussian", "uniform"]
)
IDENTITY = np.array([[1, 2], [3, 4], [2**32 - 1, 0]], np.uint32)


def test_the_numbers_themselves():
    """A version of jax with another stream would change every published result: say so here."""
    assert_allclose(
        draw_noise(GAUSSIAN, 0, IDENTITY[:2], 2, 1),
        [
            [[0.7226882, 0.1393432], [-1.33527, 1.1854682]],
            [[1.98221, 0.0017843], [1.194365, -0.6682217]],
        ],
        atol=1e-6,
    )
    assert_allclose(
        draw_noise(UNIFORM, 0, IDENTITY[:1], 2, 2),
        [[[[0.5301285], [0.1526752]]], [[[0.110821], [0.1660667]]]],
        atol=1e-6,
    )


@SPECS
def test_host_and_device_agree(spec):
    drawn = draw_noise(spec, 5, IDENTITY, 2, 4)
    assert drawn.shape == ((2, 3, 4, 1) if spec.per_agent else (2, 3, 2))
    on_device = jax.jit(scene_noise, static_argnums=(0, 3, 4))
    for scene, identity in enumerate(IDENTITY):
        assert_array_equal(
            drawn[:, scene], on_device(spec, jax.random.key(5), identity, 2, 4)
        )
    with jax.enable_x64(True):
        wide = draw_noise(spec, 5, IDENTITY, 2, 4)
    assert wide.dtype == np.float32
    assert_array_equal(wide, drawn)


@SPECS
def test_does_not_depend_on_what_else_is_drawn(spec):
    drawn = draw_noise(spec, 0, IDENTITY, 2, 8)
    assert_array_equal(draw_noise(spec, 0, IDENTITY[::-1], 2, 8)[:, ::-1], drawn)
    assert_array_equal(draw_noise(spec, 0, IDENTITY, 20, 8)[:2], drawn)
    many = np.concatenate([np.full((CHUNK, 2), 9, np.uint32), IDENTITY])
    assert_array_equal(draw_noise(spec, 0, many, 2, 8)[:, CHUNK:], drawn)
    if spec.per_agent:
        assert_array_equal(draw_noise(spec, 0, IDENTITY, 2, 3), drawn[:, :, :3])


def test_every_seed_scene_sample_and_slot_has_its_own():
    drawn = [draw_noise(UNIFORM, seed, IDENTITY, 2, 5) for seed in (0, 1, 2**32 - 1)]
    assert len(np.unique(np.stack(drawn))) == 3 * 3 * 2 * 5
