import numpy as np
import pytest
from numpy.testing import assert_allclose

from neurosym_jax.errors import InputError
from neurosym_jax.evaluation.metrics import METRICS, SYMBOLS, metric_names
from neurosym_jax.evaluation.scoring import score


def offsets(errors):
    """Forecasts that are off by `errors [k, N, T]` metres, in turning directions."""
    errors = np.asarray(errors, float)
    angle = np.arange(errors.size).reshape(errors.shape)
    return errors[..., None] * np.stack([np.cos(angle), np.sin(angle)], axis=-1)


def scene(k=20, agents=4, steps=6, seed=0):
    draw = np.random.default_rng(seed)
    return draw.normal(size=(k, agents, steps, 2)), draw.normal(size=(agents, steps, 2))


def mean(metric, forecast, truth):
    return score(forecast, truth, metrics=[metric])[metric].mean


def test_best_of_k_by_hand():
    """Two samples, two agents, two steps; each minimum lies in a sample of its own."""
    truth = np.array([[[0.0, 0.0], [1.0, 0.0]], [[5.0, 5.0], [5.0, 6.0]]])
    # Sample 0: ADE 1 and 2, FDE 2 and 3; sample 1: ADE 2 and 1.5, FDE 1 and 1.
    forecast = truth + offsets([[[0, 2], [1, 3]], [[3, 1], [2, 1]]])
    found = score(forecast, truth)
    assert all(each.count.tolist() == [2] for each in found.values())
    wanted = {
        "joint_ade": [3.0],  # Sample 0: 1 + 2.
        "joint_fde": [2.0],  # Sample 1: 1 + 1.
        "marginal_ade": [1 + 1.5],
        "marginal_fde": [1 + 1],
        "horizon": [[0 + 1, 2 + 3]],  # Sample 0.
        "collision_rate": [0],
    }
    assert found.keys() == wanted.keys()
    for name, total in wanted.items():
        assert_allclose(found[name].total, total, atol=1e-6, err_msg=name)
    far = offsets([[[0, 2.1], [9, 1.9], [0, 3]], [[0, 2.2], [0, 9], [5, 0.5]]])
    assert mean("miss_rate", far, np.zeros((3, 2, 2))) == pytest.approx(1 / 3)


def test_who_does_not_count_changes_nothing():
    rng = np.random.default_rng(0)
    forecast, truth = rng.normal(size=(4, 6, 5, 2)), rng.normal(size=(6, 5, 2))
    valid = np.array([True, False, True, True, False, True])
    forecast[:, 1], truth[4] = np.nan, np.nan
    names = [n for n, metric in METRICS.items() if not metric.moves and n not in SYMBOLS]
    alone = score(forecast[:, valid] + 5e6, truth[valid] + 5e6, metrics=names)
    for name, each in score(forecast, truth, valid, metrics=names).items():
        assert each.count == 4
        assert_allclose(each.total, alone[name].total, rtol=1e-5, err_msg=name)


def test_what_is_not_asked_for_is_not_computed():
    names = metric_names()
    assert {"joint_ade", "collision_rate"} < set(names) < set(METRICS)
    assert metric_names(["crps"], collisions=False) == (*metric_names(collisions=False), "crps")
    assert set(METRICS) - set(metric_names(["all"])) == set(SYMBOLS)
    assert set(metric_names(["all", *SYMBOLS])) == set(METRICS)
    with pytest.raises(InputError, match="unknown metric 'crsp': did you mean 'crps'"):
        metric_names(["crsp"])
    with pytest.raises(InputError, match="neighbour_share: needs forecasts without neighbours"):
        mean("neighbour_share", *scene())


def test_symbols_by_hand():
    """Two people who approach, one beyond 8 m; forecasts as it happened, and standing still."""
    step = np.arange(5)[:, None] * np.array([1.0, 0])
    paths = np.stack([step - [4, 0], [4, 0] - step, 0 * step + 100])
    observed, future = paths[:, :2], paths[:, 2:]
    standing = np.repeat(observed[:, -1:], 3, axis=1)
    for right, wrong in ((3, 0), (0, 1)):
        forecast = np.stack([future] * right + [standing] * wrong)
        found = score(forecast, future, observed=observed, metrics=SYMBOLS)
        assert found["state_log"].count == 2  # Ordered pairs.
        wanted = -np.log((right + 1 / 81) / (right + wrong + 1))
        assert found["state_log"].mean == pytest.approx(wanted, rel=1e-5)
    found = score(np.stack([future] * 3), future, observed=observed, metrics=SYMBOLS)
    assert found["event_log"].mean == pytest.approx(-np.log(3.5 / 4), rel=1e-5)


def test_proper_scores_and_the_central_sample_by_their_formulas():
    forecast, truth = scene(k=7, seed=1)
    apart = np.sqrt(np.square(forecast[:, None] - forecast).sum(axis=(2, 3, 4)))
    error = np.sqrt(np.square(forecast - truth).sum(axis=(1, 2, 3)))
    wanted = (error.mean() - apart.mean() / 2) / np.sqrt(4 * 6)
    assert_allclose(mean("energy_score", forecast, truth), wanted, rtol=1e-5)
    wanted = np.abs(forecast - truth).mean() - np.abs(forecast[:, None] - forecast).mean() / 2
    assert_allclose(mean("crps", forecast, truth), wanted, rtol=1e-5)
    medoid = np.linalg.norm(forecast[:, None] - forecast, axis=-1).mean(axis=(1, 2, 3)).argmin()
    error = np.linalg.norm(forecast[medoid] - truth, axis=-1)
    assert_allclose(mean("central_ade", forecast, truth), error.mean(), rtol=1e-5)
    assert_allclose(mean("central_fde", forecast, truth), error[:, -1].mean(), rtol=1e-5)


def test_a_single_forecast_scores_its_error():
    forecast, truth = scene(k=1)
    error = forecast[0] - truth
    wanted = np.sqrt(np.square(error).sum(axis=-1).mean())
    for k in (1, 5):
        given = np.repeat(forecast, k, axis=0)
        assert_allclose(mean("energy_score", given, truth), wanted, rtol=1e-5)
        assert_allclose(mean("crps", given, truth), np.abs(error).mean(), rtol=1e-5)


@pytest.mark.parametrize("metric", ["energy_score", "crps"])
def test_nothing_scores_better_than_the_truth_s_distribution(metric):
    forecast, truth = scene(k=200, agents=64, steps=3, seed=2)
    right = mean(metric, forecast, truth)
    for wrong in (forecast * 0.6, forecast * 1.6, forecast + 0.7):
        assert mean(metric, wrong, truth) > right + 0.01


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
