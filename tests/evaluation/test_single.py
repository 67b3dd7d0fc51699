import numpy as np
import pytest
from numpy.testing import assert_allclose

from neurosym_jax.data.batching import make_batches
from neurosym_jax.data.windows import cut_windows
from neurosym_jax.errors import InputError
from neurosym_jax.evaluation.metrics import metric_names
from neurosym_jax.evaluation.scene_scores import score
from neurosym_jax.evaluation.scoring import score_forecaster
from neurosym_jax.forecasting.baselines import ConstantVelocity, ConstantVelocitySampled
from neurosym_jax.simulation.scenarios import synthetic_tracks

BATCHES = make_batches(cut_windows([synthetic_tracks("cross-path", 0)], 8, 8))


def scores(forecaster, metrics):
    return score_forecaster(forecaster, (), BATCHES, samples=5, seed=0, metrics=metrics)


def test_the_central_sample_is_the_medoid_of_the_scene():
    draw = np.random.default_rng(0)
    forecast, truth = draw.normal(size=(9, 3, 4, 2)), draw.normal(size=(3, 4, 2))
    apart = np.linalg.norm(forecast[:, None] - forecast, axis=-1).mean(axis=(1, 2, 3))
    error = np.linalg.norm(forecast[apart.argmin()] - truth, axis=-1)
    found = score(forecast, truth, metrics=["central_ade", "central_fde"])
    assert_allclose(found["central_ade"].mean, error.mean(), rtol=1e-5)
    assert_allclose(found["central_fde"].mean, error[:, -1].mean(), rtol=1e-5)


def test_sampled_constant_velocity_without_noise_is_constant_velocity():
    names = metric_names(["noise_free_ade", "noise_free_fde"])
    plain, sampled = scores(ConstantVelocity(8), names), scores(ConstantVelocitySampled(8), names)
    for error in ("ade", "fde"):
        wanted = plain.mean(f"joint_{error}")
        assert plain.mean(f"noise_free_{error}") == pytest.approx(wanted, rel=1e-6)
        assert sampled.mean(f"noise_free_{error}") == pytest.approx(wanted, rel=1e-5)


def test_the_others_do_not_see_the_sample_without_noise():
    alone = scores(ConstantVelocitySampled(8), metric_names())
    beside = scores(ConstantVelocitySampled(8), metric_names(["noise_free_ade"]))
    assert beside.samples == alone.samples == 5
    for name, each in alone.scores.items():
        assert_allclose(beside.scores[name].total, each.total, rtol=1e-6, err_msg=name)


def test_samples_alone_have_no_noise_free_one():
    with pytest.raises(InputError, match="noise_free_ade: samples alone"):
        score(np.zeros((2, 1, 3, 2)), np.zeros((1, 3, 2)), metrics=["noise_free_ade"])
