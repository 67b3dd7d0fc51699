"""Regions hold the shares that they promise, at places where the model is wrong."""

import numpy as np
import pytest

from neurosym_robot.online.regions import LEVELS, Recalibration, Regions
from neurosym_robot.online.window import Window

PERIOD, STEPS, DRAWS = 0.4, 6, 20


def shares_held(spread: float, growth: float = 1.0, people: int = 5, frames: int = 100):
    """[F * people, L] share of its steps at which a forecast for a person holds what happened.

    People walk at 1.2 m/s with errors of 10 cm a step; forecasts are for `spread` times
    these errors, and for people whose clock runs `growth` times too fast.
    """
    rng = np.random.default_rng(1)
    step = rng.normal(0, 0.1, (people, frames, 2)) + np.array([0.48 * growth, 0])
    path = step.cumsum(axis=1)
    window = Window(3, PERIOD, memory=PERIOD * STEPS + 1.0)
    regions, held, issued = Recalibration(window), [], []
    for frame in range(frames):
        ids = np.arange(people)
        window.push(PERIOD * frame, ids, path[:, frame])
        regions.learn()
        noise = rng.normal(0, 0.1 * spread, (DRAWS, people, STEPS, 2)).cumsum(axis=2)
        ahead = np.arange(1, STEPS + 1)[:, None] * np.array([0.48, 0])
        draws = path[:, frame, None] + ahead + noise
        regions.add(window.stamp, ids, draws)
        issued.append((Regions.around(draws), regions.scale.copy()))
    for frame in range(frames - STEPS):
        center, scale = issued[frame]
        truth = path[:, frame + 1 : frame + STEPS + 1]
        factors = np.stack(
            [center.factors(n, truth[:, n]) for n in range(STEPS)], axis=-1
        )
        held.append((factors <= scale[:, None]).mean(axis=-1).T)
    return np.concatenate(held), regions


@pytest.mark.parametrize(
    ("spread", "growth"), [(1.0, 1.0), (0.3, 1.0), (3.0, 1.0), (1.0, 1.5)]
)
def test_regions_hold_their_level_whatever_the_place(spread, growth):
    held, regions = shares_held(spread, growth)
    total = np.concatenate([np.zeros((1, len(LEVELS))), held.cumsum(axis=0)])
    means = (total[200:] - total[:-200])[
        100:
    ] / 200  # [.., L] of any 200 after the first 100
    assert ((means[:, 1] > 0.85) & (means[:, 1] < 0.95)).all(), (
        means.min(0),
        means.max(0),
    )
    assert ((means[:, 0] > 0.4) & (means[:, 0] < 0.6)).all(), (
        means.min(0),
        means.max(0),
    )
    assert regions.coverage()[0.9] == pytest.approx(held[:, 1].mean(), abs=0.02)


def test_what_is_published_is_what_is_scored():
    """The ellipse of a message holds a place exactly when its factor is below the scale's."""
    rng = np.random.default_rng(0)
    draws = rng.normal(0, [1.0, 0.3], (40, 3, STEPS, 2)) + rng.normal(0, 9, (3, 1, 2))
    scale = rng.normal(0, 0.5, (len(LEVELS), STEPS))
    plain, scaled = Regions.around(draws), Regions.around(draws, scale)
    held = []
    for place in rng.normal(0, 1, (200, 3, 2)) + plain.mean[:, 2]:
        off = place - scaled.mean[:, 2]
        inverse = np.linalg.inv(scaled.covariance[:, 2])
        distance = np.sqrt(np.einsum("ni,nij,nj->n", off, inverse, off))
        inside = distance <= scaled.radius[:, :, 2]
        assert (inside == (plain.factors(2, place) <= scale[:, 2, None])).all()
        held.append(inside)
    assert 0.1 < np.mean(held) < 0.9


def test_an_outline_is_where_a_region_ends():
    rng = np.random.default_rng(1)
    turn = np.array([[0.8, -0.6], [0.6, 0.8]])
    draws = rng.normal(0, [1.0, 0.1], (4000, 1, 2, 2)) @ turn.T
    regions = Regions.around(draws)
    ring = regions.outlines(1)[1, 0]
    off = regions.mean[0, 1] - ring
    inverse = np.linalg.inv(regions.covariance[0, 1])
    radius = np.sqrt(np.einsum("pi,ij,pj->p", off, inverse, off))
    np.testing.assert_allclose(radius, regions.radius[1, 0, 1])
    axes, angle = regions.axes()
    np.testing.assert_allclose(axes[0, 1], [1.0, 0.1], rtol=0.05)
    assert np.tan(angle[0, 1]) == pytest.approx(0.75, abs=0.02)
    # A normal distribution: 90 % lie within 2.146 standard deviations.
    assert regions.radius[1, 0, 1] == pytest.approx(2.146, rel=0.03)
