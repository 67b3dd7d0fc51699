"""Every model that ships: what it learned from, and that its neighbours change its forecasts."""

import functools

import jax
import numpy as np
import pytest

from neurosym_jax.data.recordings import open_source
from neurosym_jax.data.windows import cut_windows, make_batches
from neurosym_jax.evaluation.metrics import MOVED, NEAR
from neurosym_jax.evaluation.scores import chosen, score_scenes, without_neighbours
from neurosym_jax.models.disk import load_model, shipped_models
from neurosym_jax.models.forecast import (
    Model,
    batch_noise,
    forecast_batch,
    predict_scenes,
    unpacked,
)
from tests.repository import exhaustive

PATHS = {path.name: path for path in shipped_models()}
SEEING = [name for name in PATHS if not name.startswith("anchor_table")]


@functools.cache
def shipped(name: str) -> Model:
    """The model of this name: read where a test asks for it, not where tests are collected."""
    return load_model(PATHS[name])


WORSE = {"sgan_univ_8": 1.05, "sgan_univ_12": 1.04}
"""Models whose neighbours raise the error, and by how much at most: univ has crowds of more than
the 16 people that a training scene is cropped to, and SGAN's pooling is a maximum over all."""


SAMPLE = ("_zara1_8", "_univ_12", "_general_8", "_simulations_8")
"""Ends of names: a run takes these of each family, where a change of code is noticed; a release
takes all, which differ in their parameters alone."""


def sampled(names, ends=SAMPLE):
    return [name if name.endswith(ends) else exhaustive(name) for name in names]


@pytest.mark.parametrize("name", PATHS)
def test_a_model_names_its_data_and_their_licences(name):
    model, place = shipped(name), PATHS[name]
    assert name.endswith(f"_{model.dataset}_{model.config.pred_len}")
    licences = ", ".join(f"{data} ({licence})" for data, licence in model.data.items())
    assert f"| learned from | {licences} |" in (place / "README.md").read_text(
        encoding="utf-8"
    )
    # None forbids a use, so any of them may be a default.
    assert {*model.data.values()} <= {"unstated", "MIT"}


@pytest.mark.parametrize(
    "name", [name for name in PATHS if name.startswith("anchors_")]
)
def test_every_anchors_network_has_a_distribution(name):
    assert shipped(name).config.points == 32


def test_the_anchor_table_sees_no_neighbours_and_says_so():
    tables = [name for name in PATHS if not shipped(name).forecaster.sees_neighbours]
    assert tables == [name for name in PATHS if name not in SEEING]
    assert len(tables) == 12
    for name in tables:
        assert shipped(name).neighbours is None
        assert sum(leaf.size for leaf in jax.tree.leaves(shipped(name).params)) < 1000


@functools.cache
def batches_of(dataset, obs_len, pred_len, stride, folder=None):
    """Every so many windows of a data set's test; those of all simulations without a folder."""
    source = open_source(folder)
    scenes = [dataset] if folder else source.scenes
    recordings = []
    for scene in scenes:
        recordings += source.recordings(scene, "test")
    windows = cut_windows(recordings, obs_len, pred_len)
    return make_batches(windows.take(slice(None, None, stride)))


def forecasts(model, batches):
    """For each batch: the scenes, a function of other scenes, forecasts in company and alone."""
    forecaster, params = model.forecaster, jax.device_put(model.params)
    for batch in batches:
        noise = batch_noise(forecaster, batch.scene, 20, 0)

        def forecast(scene, noise=noise):
            return forecast_batch(forecaster, params, scene, noise)[0]

        alone = forecast(*without_neighbours(batch.scene, noise))
        yield batch.scene, forecast, forecast(batch.scene), alone


def exchanged(scene):
    """The first agent of each scene of a batch among the neighbours of another scene.

    It takes the place of the first agent there: the others are moved along.
    """
    donor = np.arange(len(scene.valid))
    present = np.flatnonzero(scene.valid[:, 0])
    donor[present] = np.roll(present, len(present) // 2)
    observed, displacement = (
        scene.observed[donor].copy(),
        scene.displacement[donor].copy(),
    )
    observed += (scene.observed[:, 0, -1] - observed[:, 0, -1])[:, None, None]
    observed[:, 0], displacement[:, 0] = scene.observed[:, 0], scene.displacement[:, 0]
    return scene.replace(
        observed=observed, displacement=displacement, valid=scene.valid[donor]
    )


def first_of(scene, values):
    """Those of `values [k, A, ...]` that are of the first agent of each scene."""
    start = np.cumsum(scene.valid.sum(axis=1)) - scene.valid.sum(axis=1)
    return values[:, start[scene.valid[:, 0]]]


def furthest(first, other):
    return np.linalg.norm(first - other, axis=-1).max(axis=(0, 2))


@pytest.mark.parametrize("name", sampled(SEEING, ("_general_8", "_simulations_8")))
def test_near_neighbours_change_the_forecast(name):
    removed, strange, model = [], [], shipped(name)
    batches = batches_of(
        "simulations", model.config.obs_len, model.config.pred_len, stride=4
    )
    for scene, forecast, company, alone in forecasts(model, batches):
        last = scene.observed[scene.valid[:, 0], :, -1]
        distance = np.linalg.norm(last[:, 1:] - last[:, :1], axis=-1)
        near = (scene.valid[scene.valid[:, 0], 1:] & (distance <= NEAR)).any(axis=1)
        mine, other = first_of(scene, company), exchanged(scene)
        removed.append(furthest(mine, first_of(scene, alone))[near] > MOVED)
        strange.append(furthest(mine, first_of(other, forecast(other)))[near] > 0.01)
    assert len(np.concatenate(removed)) > 125
    assert np.concatenate(removed).mean() >= 0.95
    assert np.concatenate(strange).mean() >= 0.9


@pytest.mark.slow
@pytest.mark.parametrize(
    "name", sampled(name for name in SEEING if "general" not in name)
)
def test_neighbours_do_not_raise_the_error(name, request):
    """On scenes of the model's own test."""
    model, errors = shipped(name), []
    folder, dataset = None, str(model.dataset)
    if dataset != "simulations":
        folder = request.getfixturevalue("shared") / "data/eth_ucy"
    stride = {"univ": 16, "zara2": 8, "zara1": 4}.get(dataset, 2)
    batches = batches_of(
        dataset, model.config.obs_len, model.config.pred_len, stride, folder
    )
    for scene, _, *both_places in forecasts(model, batches):
        places = (unpacked(futures, scene.valid) for futures in both_places)
        scores = (score_scenes(chosen(["joint_ade"]), place, scene) for place in places)
        errors.append([score["joint_ade"].total.sum() for score in scores])
    company, alone = np.sum(errors, axis=0)
    assert company <= WORSE.get(name, 1) * alone


def two_walks():
    """Three people side by side, 1 m apart; and four whose paths cross."""
    time = np.arange(8.0)[:, None]
    beside = [[0.5, 0] * time + [0, metres] for metres in range(3)]
    crossing = [[0.5, 0] * time, [5, 0.8] - [0.5, 0] * time, [3, 2] + 0 * time]
    return np.array(beside), np.array([*crossing, [2, -3] + [0, 0.4] * time])


@pytest.mark.filterwarnings("ignore::neurosym_jax.errors.InputWarning")
@pytest.mark.parametrize("name", sampled(PATHS))
def test_one_bad_position_has_a_bounded_effect(name):
    """On the person's own forecast, and hardly any on the others'.

    Networks that take positions as they are have this bound where repair is asked for.
    """
    model = shipped(name)
    repair = not model.forecaster.repairs
    assert repair == name.startswith(("sgan_", "neurosym_"))
    reach = 3.0 * model.config.pred_len * model.config.period
    for walks in two_walks():
        wrong = [walks]
        for size in (1.0, 2.0, 5.0, 15.0, 100.0, 1000.0):
            for step in range(8):
                walk = walks.copy()
                walk[0, step] += size * np.array([np.sin(size), np.cos(size)])
                wrong.append(walk)
        usual, *forecasts = predict_scenes(
            model, wrong, frames=[0] * len(wrong), repair=repair
        )
        for walk, forecast in zip(wrong[1:], forecasts):
            assert np.isfinite(forecast).all()
            ahead = np.linalg.norm(forecast - walk[:, -1:], axis=-1)
            assert ahead[:, 0].max() < 25
            assert ahead[:, 1:].max() < reach
            assert np.abs(forecast[:, 1:] - usual[:, 1:]).max() < 0.5
