import jax
import numpy as np
import pytest
from numpy.testing import assert_allclose

from neurosym_jax.evaluation.metrics import COLLISION_DISTANCE, collisions
from neurosym_jax.evaluation.scoring import score

collide = jax.jit(collisions)


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
    alone = score(forecast[:, valid] + 5e6, truth[valid] + 5e6)
    for name, each in score(forecast, truth, valid).items():
        assert each.count == 4
        assert_allclose(each.total, alone[name].total, rtol=1e-6, err_msg=name)
    assert np.isnan(score(forecast, truth, np.zeros(6, bool))["joint_ade"].mean)


def test_marginal_is_never_worse_than_joint():
    rng = np.random.default_rng(1)
    found = score(rng.normal(size=(20, 6, 5, 2)), rng.normal(size=(6, 5, 2)))
    assert found["marginal_ade"].mean < found["joint_ade"].mean
    assert found["marginal_fde"].mean < found["joint_fde"].mean


def straight(start, end, steps=2):
    return np.linspace(start, end, steps)


@pytest.mark.parametrize(
    ("one", "other", "expected"),
    [
        # Both cross the middle at the same time, far from it at every step.
        (straight((-1, 0), (1, 0)), straight((0, -1), (0, 1)), True),
        # They pass through each other.
        (straight((-3, 0), (3, 0)), straight((3, 0), (-3, 0)), True),
        # The same paths, a step apart in time.
        (straight((-1, 0), (1, 0)), straight((0, -5), (0, -3)), False),
        # Side by side, nearer and farther than the limit.
        (straight((0, 0), (5, 0)), straight((0, 0.19), (5, 0.19)), True),
        (straight((0, 0), (5, 0)), straight((0, 0.21), (5, 0.21)), False),
        # Only at the last step, and only at the first.
        (straight((0, 0), (5, 0), 3), straight((5, 3), (5, 0.1), 3), True),
        (straight((0, 0), (5, 0), 3), straight((0.1, 0), (5, 9), 3), True),
        # Both stand.
        (straight((0, 0), (0, 0)), straight((0, 0), (0, 0)), True),
        # Their lines meet, but before the forecast begins.
        (straight((1, 0), (2, 0)), straight((0, 1), (0, 2)), False),
    ],
)
def test_collisions_between_steps(one, other, expected):
    hit = collide(np.stack([one, other])[None], np.ones(2, bool))
    assert hit.tolist() == [[expected, expected]]


def test_a_single_step():
    forecast = np.array([[[[0, 0]], [[0.1, 0]], [[3, 0]]]])
    assert collide(forecast, np.ones(3, bool)).tolist() == [[True, True, False]]


def test_padding_does_not_collide():
    forecast = np.zeros((2, 4, 3, 2))
    assert not collide(forecast, np.array([True, False, False, False])).any()
    assert collide(forecast, np.array([True, True, False, False])).tolist() == (
        [[True, True, False, False]] * 2
    )


def test_collisions_against_dense_sampling():
    rng = np.random.default_rng(2)
    forecast = rng.uniform(0, 3, (6, 5, 4, 2))
    time = np.linspace(0, 1, 400)[:, None]
    dense = np.concatenate(
        [forecast[:, :, [t]] * (1 - time) + forecast[:, :, [t + 1]] * time for t in range(3)],
        axis=2,
    )
    distance = np.linalg.norm(dense[:, :, None] - dense[:, None], axis=-1).min(axis=-1)
    distance[:, range(5), range(5)] = np.inf
    clear = np.abs(distance - COLLISION_DISTANCE).min(axis=-1) > 0.01
    hit = np.asarray(collide(forecast, np.ones(5, bool)))
    wanted = (distance < COLLISION_DISTANCE).any(axis=-1)
    assert (hit == wanted)[clear].all()
    assert 0.2 < wanted.mean() < 0.95
