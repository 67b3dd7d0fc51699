import numpy as np
import pytest
from numpy.testing import assert_allclose

from neurosym_jax.data.batching import make_batches
from neurosym_jax.data.windows import cut_windows
from neurosym_jax.errors import InputError
from neurosym_jax.evaluation.metrics import METRICS, SYMBOLS, metric_names
from neurosym_jax.evaluation.scene_score import score
from neurosym_jax.evaluation.scoring import score_forecaster
from neurosym_jax.forecasting.baselines import ConstantVelocity, ConstantVelocitySampled
from neurosym_jax.forecasting.forecaster import Lengths
from neurosym_jax.simulation.scenarios import synthetic_tracks


def offsets(errors):
    """Forecasts that are off by `errors [k, N, T]` metres, in turning directions."""
    errors = np.asarray(errors, float)
    angle = np.arange(errors.size).reshape(errors.shape)
    return errors[..., None] * np.stack([np.cos(angle), np.sin(angle)], axis=-1)


def test_by_hand():
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


def test_who_does_not_count_changes_nothing():
    rng = np.random.default_rng(0)
    forecast, truth = rng.normal(size=(4, 6, 5, 2)), rng.normal(size=(6, 5, 2))
    valid = np.array([True, False, True, True, False, True])
    forecast[:, 1], truth[4] = np.nan, np.nan
    names = [n for n, m in METRICS.items() if m.given == "samples" and n not in SYMBOLS]
    alone = score(forecast[:, valid] + 5e6, truth[valid] + 5e6, metrics=names)
    for name, each in score(forecast, truth, valid, metrics=names).items():
        assert each.count == 4
        assert_allclose(each.total, alone[name].total, rtol=1e-5, err_msg=name)
    assert np.isnan(score(forecast, truth, np.zeros(6, bool))["joint_ade"].mean)


def test_marginal_is_never_worse_than_joint():
    rng = np.random.default_rng(1)
    found = score(rng.normal(size=(20, 6, 5, 2)), rng.normal(size=(6, 5, 2)))
    assert found["marginal_ade"].mean < found["joint_ade"].mean
    assert found["marginal_fde"].mean < found["joint_fde"].mean


def test_a_miss_is_an_agent_whose_best_sample_ends_two_metres_off():
    truth = np.zeros((3, 2, 2))
    forecast = offsets([[[0, 2.1], [9, 1.9], [0, 3]], [[0, 2.2], [0, 9], [5, 0.5]]])
    assert score(forecast, truth, metrics=["miss_rate"])["miss_rate"].mean == pytest.approx(1 / 3)


def test_what_is_not_asked_for_is_not_computed():
    names = metric_names()
    assert {"joint_ade", "collision_rate"} < set(names) < set(METRICS)
    assert metric_names(["crps"], collisions=False) == (*metric_names(collisions=False), "crps")
    assert set(METRICS) - set(metric_names(["all"])) == set(SYMBOLS)
    assert set(metric_names(["all", *SYMBOLS])) == set(METRICS)
    with pytest.raises(InputError, match="unknown metric 'crsp': did you mean 'crps'"):
        metric_names(["crsp"])


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
    plain, sampled = (
        scores(ConstantVelocity(Lengths()), names),
        scores(ConstantVelocitySampled(Lengths()), names),
    )
    for error in ("ade", "fde"):
        wanted = plain.mean(f"joint_{error}")
        assert plain.mean(f"noise_free_{error}") == pytest.approx(wanted, rel=1e-6)
        assert sampled.mean(f"noise_free_{error}") == pytest.approx(wanted, rel=1e-5)


def test_the_others_do_not_see_the_sample_without_noise():
    alone = scores(ConstantVelocitySampled(Lengths()), metric_names())
    beside = scores(ConstantVelocitySampled(Lengths()), metric_names(["noise_free_ade"]))
    assert beside.samples == alone.samples == 5
    for name, each in alone.scores.items():
        assert_allclose(beside.scores[name].total, each.total, rtol=1e-6, err_msg=name)


def test_samples_alone_have_no_noise_free_one():
    with pytest.raises(InputError, match="noise_free_ade: samples alone"):
        score(np.zeros((2, 1, 3, 2)), np.zeros((1, 3, 2)), metrics=["noise_free_ade"])


def test_symbols_by_hand():
    """Two people who approach, one beyond 8 m; forecasts as it happened, and standing still."""
    step = np.arange(5)[:, None] * np.array([1.0, 0])
    paths = np.stack([step - [4, 0], [4, 0] - step, 0 * step + 100])
    observed, future = paths[:, :2], paths[:, 2:]
    standing = np.repeat(observed[:, -1:], 3, axis=1)
    cases = {
        (3, 0): (-np.log((3 + 1 / 81) / 4), 1 - 2 * (3 + 1 / 81) / 4),
        (0, 1): (-np.log((1 / 81) / 2), 1 - 2 * (1 / 81) / 2),
    }
    for (right, wrong), (log, brier) in cases.items():
        forecast = np.stack([future] * right + [standing] * wrong)
        found = score(forecast, future, observed=observed, metrics=SYMBOLS)
        assert found["state_log"].count == 2  # Ordered pairs.
        assert found["state_log"].mean == pytest.approx(log, rel=1e-5)
        k = right + wrong
        square = ((k + 1 / 81) ** 2 + 80 / 81**2) / (k + 1) ** 2
        assert found["state_brier"].mean == pytest.approx(brier + square, rel=1e-5)
    found = score(np.stack([future] * 3), future, observed=observed, metrics=SYMBOLS)
    assert found["event_log"].mean == pytest.approx(-np.log(3.5 / 4), rel=1e-5)
    assert found["event_brier"].mean == pytest.approx(2 * 0.125**2, rel=1e-5)
