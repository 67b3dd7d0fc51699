import numpy as np
import pytest

from neurosym_jax.evaluation import collision
from neurosym_jax.evaluation.collision import COLLISION_DISTANCE, collisions
from neurosym_jax.evaluation.scoring import score


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
        # Both stand; a single step.
        (straight((0, 0), (0, 0)), straight((0, 0), (0, 0)), True),
        (straight((0, 0), (0, 0), 1), straight((0.1, 0), (0, 0), 1), True),
        # Their lines meet, but before the forecast begins.
        (straight((1, 0), (2, 0)), straight((0, 1), (0, 2)), False),
    ],
)
def test_collisions_between_steps(one, other, expected):
    """Slots of padding, all at one place, collide with nobody."""
    forecast = np.stack([one, other, 0 * one, 0 * one])[None]
    hit = collisions(forecast, np.array([True, True, False, False]))
    assert hit.tolist() == [[expected, expected, False, False]]


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
    hit = np.asarray(collisions(forecast, np.ones(5, bool)))
    wanted = (distance < COLLISION_DISTANCE).any(axis=-1)
    assert (hit == wanted)[clear].all()
    assert 0.2 < wanted.mean() < 0.95


@pytest.fixture(scope="module")
def crowd():
    """Twenty samples of forty people who walk 5 m in a hall of 12 m."""
    draw = np.random.default_rng(5)
    step = draw.normal(0, 0.4, (40, 1, 2)) + draw.normal(0, 0.1, (20, 40, 12, 2))
    return (draw.uniform(0, 12, (40, 1, 2)) + step.cumsum(axis=2)).astype(np.float32)


def test_boxes_change_nothing(crowd, monkeypatch):
    valid = np.arange(40) % 7 > 0
    found = collisions(crowd, valid)
    assert 0.02 < found.mean() < 0.6
    monkeypatch.setattr(collision, "REACH", np.inf)
    assert (collisions(crowd, valid) == found).all()


def test_the_excess_is_what_forecasts_collide_more_than_the_truth(crowd):
    truth = crowd[3]
    names = ("collision_rate", "truth_collision_rate", "excess_collisions")
    rate, true, excess = (each.mean for each in score(crowd, truth, metrics=names).values())
    everybody = np.ones(40, bool)
    assert rate == pytest.approx(collisions(crowd, everybody).mean(), rel=1e-6)
    assert true == pytest.approx(collisions(truth[None], everybody).mean(), rel=1e-6)
    assert excess == pytest.approx(rate - true)
    assert score(truth[None], truth, metrics=names)["excess_collisions"].mean == 0
