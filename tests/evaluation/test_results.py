"""Rows over several seeds of the noise, and tests that run elsewhere."""

import dataclasses

import numpy as np
import pytest

import neurosym_jax as nj
from neurosym_jax.data.recordings import Synthetic
from neurosym_jax.evaluation.compare import (
    Settings,
    evaluate_tests,
    load_tests,
    make_plan,
    with_tests,
)
from neurosym_jax.evaluation.intervals import paired_difference


@pytest.fixture(scope="module")
def simulated():
    source, baselines = Synthetic(), ["constant_velocity_sampled", "constant_velocity"]
    return load_tests(
        source, make_plan(source, [], dataset="cross-path", baselines=baselines)
    )


def rows(*arguments):
    return [result.row for result in evaluate_tests(*arguments)]


def test_the_mean_and_deviation_are_those_of_the_seeds(simulated):
    row, one_guess = rows(simulated, Settings(samples=3, seed=5, seeds=3))
    assert one_guess["joint_ade_std"] is None
    single = [rows(simulated, Settings(samples=3, seed=seed))[0] for seed in (5, 6, 7)]
    for name in ("joint_ade", "marginal_fde"):
        values = [result_row[name] for result_row in single]
        assert len(set(values)) == 3
        assert row[name] == pytest.approx(np.mean(values))
        assert row[f"{name}_std"] == pytest.approx(np.std(values, ddof=1))


def test_a_test_set_can_be_evaluated_elsewhere(simulated):
    local, mapped = (
        rows(simulated, Settings(samples=3)),
        rows(simulated, Settings(samples=3), map),
    )
    assert [row["joint_ade"] for row in local] == [row["joint_ade"] for row in mapped]


def test_models_are_compared_with_the_best_of_their_test_set(simulated):
    """By hand: the difference of both on the same scenes, and trainings as one model."""
    results = list(evaluate_tests(simulated, Settings(samples=3)))
    rows = with_tests(results)
    first, second = sorted(rows, key=lambda row: row["joint_ade"])
    ordered = sorted(results, key=lambda result: result.row["joint_ade"])
    assert first["joint_ade_p"] is None
    difference = paired_difference([ordered[0].errors], [ordered[1].errors])
    assert second["joint_ade_p"] == pytest.approx(difference.over_both.p_value(0))
    assert 0 < second["joint_ade_p"] < 1

    identities = [
        {"configuration": name, "training_data": "all", "training_seed": seed}
        for name, seed in (("a", 0), ("a", 1), ("b", 0))
    ]
    runs = [
        dataclasses.replace(
            results[0], row=results[0].row | identity | {"joint_ade": ade}
        )
        for identity, ade in zip(identities, (0.1, 0.5, 0.4))
    ]
    seed0, seed1, other = with_tests([*runs, results[1]])[:3]
    assert (seed0["joint_ade_p"], seed1["joint_ade_p"]) == (None, None)
    assert other["joint_ade_p"] == 1  # The errors of all three are the same.
    # One training, the best, against two: the mean over both.
    better, worse = ordered
    rows = [
        dataclasses.replace(result, row=result.row | identity | {"model": "m"})
        for identity, result in zip(identities, (better, worse, better))
    ]
    difference = paired_difference([better.errors] * 2, [better.errors, worse.errors])
    p_values = [row["joint_ade_p"] for row in with_tests(rows)]
    assert p_values == [pytest.approx(difference.over_both.p_value(0))] * 2 + [None]


def test_the_scene_that_is_shown_is_harder_than_nine_of_ten(simulated):
    """Of constant velocity, whose errors are computed here."""
    straight = dataclasses.replace(simulated[0], entries=simulated[0].entries[-1:])
    (result,) = evaluate_tests([straight], Settings())
    example = result.example
    present = int(example.valid.sum())
    truth = example.future[:present] + example.origin
    shown = np.linalg.norm(result.forecast[0, :present] - truth, axis=-1).mean()

    windows = straight.windows
    past, future = np.split(windows.position, [windows.obs_len], axis=1)
    steps = np.arange(1, future.shape[1] + 1)[:, None]
    guess = past[:, -1:] + steps * (past[:, -1:] - past[:, -2:-1])
    errors = np.linalg.norm(guess - future, axis=-1).mean(axis=1)
    means = np.add.reduceat(errors, windows.bounds[:-1]) / windows.sizes
    means = means[windows.sizes <= 8]
    assert np.mean(means < shown - 1e-5) == pytest.approx(0.9, abs=2 / len(means))


def test_another_scene_is_shown_where_one_is_asked_for(simulated):
    straight = dataclasses.replace(simulated[0], entries=simulated[0].entries[-1:])
    (result,) = evaluate_tests([straight], Settings(scene=17))
    example = result.example
    windows = straight.windows
    truth = windows.position[windows.bounds[17] : windows.bounds[18], windows.obs_len :]
    present = int(example.valid.sum())
    shown = example.future[:present] + example.origin
    np.testing.assert_allclose(shown, truth, atol=1e-5)


def test_the_seed_is_0_by_default():
    model, tracks = (
        nj.load_model("sgan_simulations_8"),
        Synthetic().recordings("cross-path"),
    )
    options = {"samples": 3, "metrics": ["joint_ade"], "baselines": []}
    default, same, other = (
        nj.evaluate(model, tracks, **options, **seed)["joint_ade"].item()
        for seed in ({}, {"seed": 0}, {"seed": 1})
    )
    assert default == same != other
