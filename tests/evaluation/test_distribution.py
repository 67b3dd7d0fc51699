import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.stats import gaussian_kde

from neurosym_jax.evaluation.scene_score import score


def scene(k=20, agents=4, steps=6, seed=0):
    draw = np.random.default_rng(seed)
    return draw.normal(size=(k, agents, steps, 2)), draw.normal(size=(agents, steps, 2))


def mean(metric, forecast, truth):
    return score(forecast, truth, metrics=[metric])[metric].mean


def test_energy_score_and_crps_are_those_of_scoringrules():
    rules = pytest.importorskip("scoringrules", reason="scoringrules is not installed")
    forecast, truth = scene()
    k, agents, steps, _ = forecast.shape
    joint = rules.es_ensemble(truth.ravel(), forecast.reshape(k, -1), estimator="nrg")
    found = mean("energy_score", forecast, truth)
    assert_allclose(found, joint / np.sqrt(agents * steps), rtol=1e-5)
    each = rules.crps_ensemble(truth, np.moveaxis(forecast, 0, -1), estimator="nrg")
    assert_allclose(mean("crps", forecast, truth), each.mean(), rtol=1e-5)


def test_energy_score_and_crps_by_their_formulas():
    forecast, truth = scene(k=7, seed=1)
    apart = np.sqrt(np.square(forecast[:, None] - forecast).sum(axis=(2, 3, 4)))
    error = np.sqrt(np.square(forecast - truth).sum(axis=(1, 2, 3)))
    wanted = (error.mean() - apart.mean() / 2) / np.sqrt(4 * 6)
    assert_allclose(mean("energy_score", forecast, truth), wanted, rtol=1e-5)
    wanted = np.abs(forecast - truth).mean() - np.abs(forecast[:, None] - forecast).mean() / 2
    assert_allclose(mean("crps", forecast, truth), wanted, rtol=1e-5)


def test_a_single_forecast_scores_its_error():
    forecast, truth = scene(k=1)
    error = forecast[0] - truth
    wanted = np.sqrt(np.square(error).sum(axis=-1).mean())
    for k in (1, 5):
        given = np.repeat(forecast, k, axis=0)
        assert_allclose(mean("energy_score", given, truth), wanted, rtol=1e-5)
        assert_allclose(mean("crps", given, truth), np.abs(error).mean(), rtol=1e-5)


@pytest.mark.parametrize("metric", ["energy_score", "crps", "kde_nll"])
def test_nothing_scores_better_than_the_truth_s_distribution(metric):
    forecast, truth = scene(k=200, agents=64, steps=3, seed=2)
    right = mean(metric, forecast, truth)
    for wrong in (forecast * 0.6, forecast * 1.6, forecast + 0.7):
        assert mean(metric, wrong, truth) > right + 0.01


def test_kernel_density_is_scipy_s():
    forecast, truth = scene(agents=5, seed=3)
    truth[4] += 30
    forecast = forecast @ np.array([[1.0, 0.9], [0, 0.3]])
    densities = [
        max(gaussian_kde(forecast[:, agent, step].T).logpdf(truth[agent, step])[0], -20)
        for agent in range(5)
        for step in range(6)
    ]
    assert min(densities) == -20
    assert_allclose(mean("kde_nll", forecast, truth), -np.mean(densities), rtol=1e-4)


def test_what_has_no_density_has_the_least_one():
    _, truth = scene()
    still = np.repeat(truth[None], 20, axis=0)
    on_a_line = still + np.linspace(0, 1, 20)[:, None, None, None]
    for forecast in (still, on_a_line):
        assert mean("kde_nll", forecast, truth) == 20
    assert np.isnan(mean("kde_nll", still[:2], truth))


@pytest.mark.parametrize("k", [2, 5, 20])
def test_a_calibrated_forecast_covers_what_it_should(k):
    forecast, truth = scene(k, agents=256, steps=12, seed=4)
    for level in (50, 90):
        share = mean(f"coverage_{level}", forecast, truth)
        assert share == pytest.approx(level / 100, abs=0.03)
        if k > 2:
            assert mean(f"coverage_{level}", 0.5 * forecast, truth) < share - 0.1
            assert mean(f"coverage_{level}", 3 * forecast, truth) > share + 0.05


def test_a_region_needs_two_samples_and_holds_its_share_of_equals():
    _, truth = scene()
    assert np.isnan(mean("coverage_90", truth[None], truth))
    still = np.repeat(truth[None], 20, axis=0)
    assert mean("coverage_90", still, truth) == pytest.approx(0.9)
    assert mean("coverage_90", still + 0.01, truth) == 0
