"""The study of weightings: its control, whom it calls interacting, and what its tests say."""

import importlib
from unittest import mock

import numpy as np
import pytest

from neurosym_jax.evaluation.bootstrap import ErrorsByScene
from neurosym_jax.symbolic.weightings import WEIGHTINGS, make_weighting
from studies.weighting.alpha import spread
from studies.weighting.comparison import adjusted, compare, verdict
from studies.weighting.control import LENGTHS, PEOPLE, control
from studies.weighting.scores import interacting

METRIC = "interacting joint_ade"


@pytest.fixture(scope="module", autouse=True)
def _weightings_of_the_study():
    """Registered for these tests alone."""
    with mock.patch.dict(WEIGHTINGS):
        # Again, where it was imported before: these tests need not follow one another.
        importlib.import_module("studies.weighting.arms").register()
        yield


def test_in_the_control_people_give_way_to_those_who_are_weighed_and_to_nobody_else():
    windows = control(20, 0)
    path = windows.position.reshape(20, PEOPLE, sum(LENGTHS), 2)
    right = make_weighting("on_ones_path")
    acts = np.stack([right(scene[:, : LENGTHS[0]])[..., -1] for scene in path])
    someone = (acts * ~np.eye(PEOPLE, dtype=bool)).any(axis=2)
    step = path[:, :, LENGTHS[0] - 1] - path[:, :, LENGTHS[0] - 2]
    straight = path[:, :, LENGTHS[0] - 1] + step * LENGTHS[1]
    missed = np.linalg.norm(path[:, :, -1] - straight, axis=-1)
    assert 0.2 < someone.mean() < 0.95
    assert np.median(missed[someone]) > 5 * np.median(missed[~someone])


def test_wrong_weights_are_the_right_ones_of_other_pairs():
    scene = control(1, 3).position[:, : LENGTHS[0]]
    right, wrong = (
        np.asarray(make_weighting(name)(scene))[..., 1:]
        for name in ("on_ones_path", "on_ones_path_wrong_pairs")
    )
    assert np.array_equal(right.sum(axis=(1, 2)), wrong.sum(axis=(1, 2)))
    assert not np.array_equal(right, wrong)


def test_cnd_is_a_constant_where_nobody_stands_and_quantised_is_not():
    assert max(spread(control(5, 1), "cnd")) == pytest.approx(0, abs=1e-6)
    assert min(spread(control(5, 1), "quantised")) > 0.01


def test_who_interacts_has_somebody_near_who_comes_nearer():
    #          0 and 1 near each other, 2 goes away from 1, 3 is far, 4 is padding
    before = np.array([[0, 0], [1.5, 0], [2.5, 0], [9, 9], [0.5, 0]])
    last = np.array([[0.1, 0], [1.5, 0], [2.6, 0], [9, 9], [0.5, 0]])
    observed = np.stack([before, last], axis=1)
    valid = np.array([True, True, True, True, False])
    assert interacting(observed, valid).tolist() == [True, True, False, False, False]


def made(mean, seed, scale=0.005):
    noise = np.random.default_rng(seed).normal(0, scale)
    totals = (mean + noise) * np.ones((40, 1)) * 3
    identity = np.stack([np.zeros(40), np.arange(40)], axis=1)
    return ErrorsByScene((METRIC,), totals, np.full((40, 1), 3.0), identity, 20)


@pytest.mark.parametrize(
    ("mean", "scale", "answer"), [(0.45, 0.005, "yes"), (0.5, 0.003, "no"), (0.5, 0.03, "open")]
)
def test_verdicts(mean, scale, answer):
    runs = {
        name: {seed: made(middle, 100 * place + seed, scale) for seed in range(12)}
        for place, (name, middle) in enumerate(
            {"quantised": mean, "ones": 0.5, "shuffled": 0.5}.items()
        )
    }
    del runs["shuffled"][11]
    found = [compare("quantised", name, runs, METRIC) for name in ("ones", "shuffled")]
    assert [each.seeds for each in found] == [12, 11]
    assert found[0].percent == pytest.approx(100 * (mean / 0.5 - 1), abs=300 * scale)
    assert found[0].low < found[0].percent < found[0].high
    assert verdict(found, *adjusted(found), seen=True) == answer
    assert verdict(found, *adjusted(found), seen=False) == answer.replace("no", "open")
