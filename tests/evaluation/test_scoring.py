"""Scores against direct loops, metrics of one's own, and errors as a user gets them."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import polars as pl
import pytest
from numpy.testing import assert_allclose

import neurosym_jax as nj
from neurosym_jax.data.tracks import Tracks, make_tracks
from neurosym_jax.data.windows import cut_windows, make_batches
from neurosym_jax.errors import InputError
from neurosym_jax.evaluation.metrics import collisions, register_metric
from neurosym_jax.evaluation.scores import DRAWS, score_forecaster
from neurosym_jax.models.anchors.config import AnchorConfig, AnchorTableConfig
from neurosym_jax.models.baselines import ConstantVelocity, ConstantVelocitySampled
from neurosym_jax.models.forecast import draw_batch
from neurosym_jax.models.forecaster import Lengths, draw_noise, forecaster_of
from neurosym_jax.models.sgan.network import GeneratorConfig
from tests.networks import random_model
from tests.registrations import restored_registrations


def crowd() -> Tracks:
    """Twenty frames of six people; four of them leave early."""
    rng = np.random.default_rng(0)
    walks = rng.uniform(0, 4, (6, 1, 2)) + rng.normal(0, 0.4, (6, 20, 2)).cumsum(axis=1)
    agent, frame = np.nonzero(
        np.arange(20) < np.array([20, 20, 17, 17, 18, 18])[:, None]
    )
    return make_tracks("crowd", frame * 0.4, agent, walks[agent, frame])


WINDOWS = cut_windows([crowd()], 8, 8)
SIXES = WINDOWS.take(np.flatnonzero(WINDOWS.sizes > 4))
"""Those whose programs are of one size, with two slots that are empty."""


def direct(windows, samples, spec):
    """Constant velocity, turned by its noise, by loops over scenes, samples and agents."""
    total = dict.fromkeys(
        ("joint_ade", "joint_fde", "marginal_ade", "marginal_fde", "collision_rate"), 0
    )
    horizon = np.zeros(8)
    for scene in range(windows.scenes):
        world = windows.position[slice(*windows.bounds[scene : scene + 2])]
        agents = len(world)
        noise = draw_noise(spec, 3, windows.identity[[scene]], samples, agents)[:, 0]
        angle = (
            np.radians(25) * noise[..., 0].astype(float)
            if spec.dim
            else np.zeros((1, agents))
        )
        step = (world[:, 7] - world[:, 6]) @ np.array([1, 1j])
        path = np.exp(1j * angle)[..., None] * step[:, None] * np.arange(1, 9)
        forecast = world[:, 7, None] + np.stack([path.real, path.imag], axis=-1)
        error = np.linalg.norm(forecast - world[:, 8:], axis=-1)
        ade, fde = error.mean(axis=-1), error[..., -1]
        total["joint_ade"] += min(ade.sum(axis=1))
        total["joint_fde"] += min(fde.sum(axis=1))
        total["marginal_ade"] += sum(min(ade[:, agent]) for agent in range(agents))
        total["marginal_fde"] += sum(min(fde[:, agent]) for agent in range(agents))
        total["collision_rate"] += (
            np.asarray(collisions(forecast, np.ones(agents, bool))).sum() / samples
        )
        horizon += error[ade.sum(axis=1).argmin()].sum(axis=0)
    return {
        name: value / windows.agents for name, value in total.items()
    }, horizon / windows.agents


@pytest.mark.parametrize(
    ("family", "slots", "samples"),
    [
        (ConstantVelocitySampled, 8, 5),
        (ConstantVelocitySampled, 256, 5),
        (ConstantVelocity, 8, 1),
    ],
)
def test_equal_to_a_direct_loop(family, slots, samples):
    forecaster = family(Lengths())
    result = score_forecaster(
        forecaster, (), make_batches(WINDOWS, slots), samples=5, seed=3
    )
    assert len(set(WINDOWS.sizes.tolist())) > 1
    expected, horizon = direct(WINDOWS, samples, forecaster.noise)
    assert expected["collision_rate"] > 0
    for name, value in expected.items():
        assert_allclose(result.mean(name), value, rtol=1e-5, err_msg=name)
    assert_allclose(result.scores["horizon"].mean, horizon, rtol=1e-5)
    assert_allclose(
        result.scores["horizon"].mean.mean(), expected["joint_ade"], rtol=1e-5
    )
    assert (result.samples, result.agents) == (samples, WINDOWS.agents)
    assert result.scores["joint_ade"].count.tolist() == WINDOWS.sizes.tolist()
    assert result.seconds > 0


@pytest.mark.slow
def test_distributions_are_scored_by_draws_of_their_own():
    """The CRPS of each person by pairs of 100 draws; errors are those of the samples."""
    model, batches = (
        random_model(AnchorConfig(8, 8, points=8), std=0.3),
        make_batches(SIXES, 16),
    )

    def scores(*metrics):
        options = {"samples": 20, "seed": 3, "metrics": metrics}
        return score_forecaster(model.forecaster, model.params, batches, **options)

    both, total = scores("joint_ade", "crps"), 0.0
    for batch in batches:
        scene, valid = batch.scene, np.asarray(batch.scene.valid)
        draws = draw_batch(model.forecaster, model.params, scene, 3, 100)[:, valid]
        error = np.abs(draws - np.asarray(scene.known_future)[valid]).mean(axis=0)
        spread = np.abs(draws[:, None] - draws).sum(axis=(0, 1)) / (100 * 99)
        total += (error - spread / 2).mean(axis=(1, 2)).sum()
    assert both.mean("crps") == pytest.approx(total / SIXES.agents, rel=1e-5)
    assert both.mean("joint_ade") == scores("joint_ade").mean("joint_ade")


SMALL = {"obs_len": 8, "pred_len": 8}
COMPARED = {
    "sampled": ConstantVelocitySampled(Lengths()),
    "anchors": forecaster_of(AnchorConfig(points=8)),
    "no points": forecaster_of(AnchorConfig()),
    "table": forecaster_of(AnchorTableConfig()),
    "SGAN": forecaster_of(GeneratorConfig(pooling="none", **SMALL)),
}


@pytest.mark.parametrize("name", COMPARED)
def test_whoever_is_compared_is_scored_by_the_same_number_of_draws(name):
    """One k for all, whatever number of samples is asked for."""
    forecaster, counts = COMPARED[name], []
    shapes = forecaster.shapes()
    params = jax.tree.map(lambda leaf: np.zeros(leaf.shape, leaf.dtype), shapes)

    def count_draws(forecast, scene):
        counts.append(len(forecast))
        return forecast[0, :, 0, 0]

    register_metric("count", "draws", drawn=True)(count_draws)
    options = {"samples": 3, "seed": 0, "metrics": ("count", "joint_ade")}
    batches = make_batches(SIXES, 16)
    evaluation = score_forecaster(forecaster, params, batches, **options)
    assert set(counts) == {DRAWS}
    assert (evaluation.draws, evaluation.samples) == (DRAWS, 3)


def own(compute, windows=WINDOWS):
    """Scores of constant velocity by a metric of one's own, which is registered meanwhile."""
    with restored_registrations():
        register_metric("own", "own metric")(compute)
        with pytest.raises(InputError, match="another metric 'own' already"):
            register_metric("own", "own metric")(print)
        options = {"samples": 1, "seed": 0, "metrics": ("own",)}
        evaluation = score_forecaster(
            ConstantVelocity(Lengths()), (), make_batches(windows), **options
        )
    assert tuple(evaluation.scores) == ("own",)
    return evaluation.scores["own"]


def test_own_metrics():
    sizes, group = WINDOWS.sizes, np.arange(WINDOWS.agents) % 3
    per_scene = own(
        lambda forecast, scene: (jnp.where(scene.valid, 1.0, 0).sum() ** 2, 1)
    )
    assert per_scene.mean == pytest.approx(np.mean(sizes**2))
    unweighted = own(lambda forecast, scene: scene.valid.sum().astype(float))
    assert unweighted.mean == pytest.approx(np.sum(sizes**2) / np.sum(sizes))
    nothing = own(lambda forecast, scene: (forecast[0, ..., 0], 0 * scene.valid))
    assert nothing.total.shape == (WINDOWS.scenes, 8)
    assert np.isnan(nothing.mean).all()
    # Weights of slots without a person are ignored.
    per_agent = own(
        lambda forecast, scene: (
            scene.observed[:, 0, 0] + 9,
            1 + 0 * forecast[0, :, 0, 0],
        )
    )
    assert per_agent.count.tolist() == sizes.tolist()
    firsts = [
        batch.scene.observed[batch.scene.valid][:, 0, 0]
        for batch in make_batches(WINDOWS)
    ]
    assert per_agent.mean == pytest.approx(np.concatenate(firsts).mean() + 9, rel=1e-5)
    grouped = dataclasses.replace(WINDOWS, extras={"group": group})
    in_group = own(lambda forecast, scene: scene.extras["group"] == 2, grouped)
    assert in_group.mean == pytest.approx((group == 2).mean())


@pytest.mark.parametrize(
    ("compute", "message"),
    [
        (
            lambda forecast, scene: (scene.future.sum(), scene.valid),
            r"alike, not \[\] and \[4\]",
        ),
        (lambda forecast, scene: (scene.valid, 1), r"alike, not \[4\] and \[\]"),
        (lambda forecast, scene: forecast[0], r"alike, not \[4, 8, 2\]"),
        (lambda forecast, scene: forecast @ scene.valid, "TypeError"),
    ],
)
def test_functions_that_are_no_metric_are_refused(compute, message):
    with pytest.raises(InputError, match=f"metric own: .*{message}"):
        own(compute)


def test_means_are_of_people_and_not_of_scenes():
    """Three people go straight on; of two, one stops when the forecast begins."""
    steps = np.clip(np.arange(16), 0, [[7], *[[15]] * 4])
    x, y = 0.4 * steps, 2.0 * np.arange(5)[:, None] + 0 * steps
    frames = [
        pl.DataFrame(
            {"frame": np.tile(10 * np.arange(16), len(ids)), "id": np.repeat(ids, 16)}
            | {"x": x[ids].ravel(), "y": y[ids].ravel()}
        )
        for ids in ([0, 1], [2, 3, 4])
    ]
    model = nj.load_model("anchors_zara1_8")
    rows = nj.evaluate(
        model,
        frames,
        baselines=("constant_velocity",),
        allow=("fast", "together", "held"),
    )
    row = rows.row(0, named=True)
    assert (row["model"], row["scenes"], row["agents"]) == ("constant velocity", 2, 5)
    # 0.4 m to 3.2 m behind are 1.8 m in the mean; by scenes it would be 1.8 / 2 / 2.
    assert row["joint_ade"] == pytest.approx(1.8 / 5, abs=1e-5)
    assert row["joint_fde"] == pytest.approx(3.2 / 5, abs=1e-5)
