import numpy as np
import pytest
from numpy.testing import assert_allclose

from neurosym_jax.errors import InputError
from neurosym_jax.evaluation.metrics import METRICS, metric_names
from neurosym_jax.evaluation.scene_scores import score


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
    names = [name for name, metric in METRICS.items() if not metric.noise_free]
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
    assert metric_names(["crps"], costly=False) == (*metric_names(costly=False), "crps")
    assert metric_names(["all"]) == tuple(METRICS)
    with pytest.raises(InputError, match="unknown metric 'crsp': did you mean 'crps'"):
        metric_names(["crsp"])
