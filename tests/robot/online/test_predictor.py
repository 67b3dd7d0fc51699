"""Online is offline: the same windows, the same noise, the same forecasts."""

import dataclasses
import gc
import itertools
import os
import threading
import time
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from neurosym_jax.data.tracks import resample
from neurosym_jax.data.windows import cut_windows, make_batches
from neurosym_jax.errors import InputError
from neurosym_jax.models.anchors.network import AnchorTableConfig
from neurosym_jax.models.forecast import (
    SceneForecaster,
    forecast_batch,
    predict,
    unpacked,
)
from neurosym_jax.models.forecaster import draw_noise
from neurosym_jax.scene import make_scene, pad_scene
from neurosym_jax.simulation.scenarios import simulate
from neurosym_robot.online.predictor import Predictor, load_models
from neurosym_robot.online.replay import Analytics, replay
from neurosym_robot.tracking.following import Frame, frames_of_tracks
from tests.compiling import compile_seconds
from tests.networks import random_model
from tests.robot.ros.tcpros.conftest import wait

RATE, PEOPLE, OBS = 10, 12, 4
MEMORY = Path("/proc/self/statm")


@pytest.mark.slow
def test_frame_by_frame_equals_batches_of_windows(model):
    tracks = simulate("cross-path", 3, 12.0, people=5)
    models = {"sgan": model(), "neurosym": model("as_described", "ped")}
    options = {
        "samples": 3,
        "seed": 7,
        "recording": tracks.recording,
        "compile": "needed",
    }
    predictor = Predictor(models, max_people=8, **options)
    pushed = [predictor.push(*frame) for frame in frames_of_tracks(tracks)]
    assert None not in pushed
    forecasts = [forecast for forecast in pushed if len(forecast.ids)]
    assert len(forecasts) == len(np.unique(tracks.stamp)) - 12  # One with every frame.
    windows = cut_windows([resample(tracks, 0.4)], 4, 3)
    for (name, forecast), batch in itertools.product(
        models.items(), make_batches(windows)
    ):
        forecaster, scene = forecast.forecaster, batch.scene
        noise = draw_noise(forecaster.noise, 7, np.asarray(scene.identity), 3, 8)
        futures, _ = forecast_batch(forecaster, forecast.params, scene, noise)
        futures = unpacked(futures, scene.valid)
        for at, n in enumerate(batch.index):
            if n < 0:
                continue
            online = forecasts[4 * n]
            assert online.index - 3 == windows.identity[n, 1]
            offline = futures[:, at, :5] + scene.origin[at]
            assert_allclose(online.models[name].samples, offline, atol=1e-5)
            part = slice(windows.bounds[n], windows.bounds[n + 1])
            assert_allclose(online.observed, windows.position[part, :4], atol=1e-9)
            assert_array_equal(online.ids, windows.agent[part])


def test_equals_predict_with_people_coming_and_going(model):
    rng = np.random.default_rng(0)
    predictor = Predictor(model(), samples=6, seed=3, recording="r", max_people=4)
    sizes = set()
    for n in range(60):
        present = np.flatnonzero(rng.random(3) < 0.9) if n > 30 else np.array([1])
        forecast = predictor.push(
            n / 10, present, np.stack([present + n / 20, present * 0.5], 1)
        )
        if not len(forecast.ids):
            continue
        sizes.add(len(forecast.ids))
        (result,) = forecast.models.values()
        expected = predict(
            model(),
            forecast.observed,
            samples=6,
            seed=3,
            recording="r",
            frame=forecast.index - 3,
        )
        assert_allclose(result.samples, expected, atol=1e-5)
        assert_allclose(result.mean, expected.mean(axis=0), atol=1e-5)
        between = expected[:, None] - expected[None]
        assert result.central == (between**2).sum(axis=(1, 2, 3, 4)).argmin()
        assert forecast.index == round(forecast.stamp / 0.4)
        assert forecast.latency > 0
    assert {1, 2, 3} <= sizes


@pytest.mark.slow
@pytest.mark.parametrize(
    ("x", "nearest"), [(2.0, [2, 2, 2, 1, 1]), (-9.0, [1, 1, 1, 1, 2])]
)
def test_the_nearest_now_are_forecast_and_those_nearest_to_the_robot(model, x, nearest):
    """2 comes from afar and passes 1, who stands."""
    frames = [
        Frame(n * 0.4, np.array([1, 2]), np.array([[0.0, 0], [6 - n, 1]]))
        for n in range(8)
    ]
    options = {"samples": 2, "max_people": 1, "compile": "needed"}
    one, other = (Predictor(model(), **options) for _ in range(2))
    robot = np.array([x, 0.0, 0.0])
    events = replay(frames, one, Analytics(one), robot=lambda stamp: robot)
    pushed = [other.push(*frame, focus=robot[:2]) for frame in frames]
    for forecasts in ([event.forecast for event in events], pushed):
        made = [forecast for forecast in forecasts if len(forecast.ids)]
        assert [forecast.ids.item() for forecast in made] == nearest
        for forecast in made:
            assert forecast.dropped == {3 - forecast.ids.item(): "crowded"}


@pytest.mark.slow
def test_the_past_is_kept_until_a_long_forecast_is_scored():
    predictor = Predictor(random_model(AnchorTableConfig(4, 60)), compile="needed")
    for n in range(80):
        predictor.push(n * 0.4, [1], [[0.4 * n, 0.0]])
    past = predictor.window.stamp - 60 * 0.4
    assert_allclose(predictor.window.resampled([1], [past]), [[[past, 0]]], atol=1e-9)


@pytest.mark.slow
def test_a_recording_waits_for_programs_that_it_needs(model):
    notices: list[str] = []
    predictor = Predictor(
        model(), samples=2, max_people=40, compile="needed", report=notices.append
    )
    used: list[int] = []
    gc.unfreeze()
    predictor.programs.add(lambda forecast: used.append(len(forecast.ids)))
    assert not notices
    ids = np.arange(10)
    for n in range(4):
        forecast = predictor.push(n * 0.4, ids, np.stack([ids, ids + n * 0.4], 1))
    assert len(forecast.ids) == 10
    assert notices == ["compiling for up to 16 people (3 of 5)"]
    assert used == [16]
    assert gc.get_freeze_count() > 1000
    assert forecast.latency < 0.5
    assert predictor.waited > forecast.latency


@pytest.mark.slow
def test_a_robot_does_not_wait_and_says_who_does(model):
    """Nobody is forecast at first, then fewer, then all; no frame waits."""
    notices: list[str] = []
    started, go = {4: threading.Event(), 16: threading.Event()}, threading.Event()
    hold = threading.Event()

    def report(text):
        notices.append(text)
        for size, event in started.items():
            if f"up to {size} people" in text:
                event.set()
                (hold if size == 4 else go).wait(20)

    gc.unfreeze()
    predictor = Predictor(
        model(), samples=2, max_people=12, compile="meanwhile", report=report
    )
    ids = np.arange(10)

    def push(n: int):
        return predictor.push(n * 0.4, ids, np.stack([ids, ids + n * 0.4], 1))

    started[4].wait(20)
    began = time.monotonic()
    assert [len(push(n).ids) for n in range(4)] == [0] * 4
    assert time.monotonic() - began < 2
    assert predictor.dropped == dict.fromkeys(range(10), "compiling")
    hold.set()
    # What the people present need comes next, before the program for eight.
    started[16].wait(20)
    forecast = push(4)
    # The middle of all is at 4.5: these are the nearest.
    assert forecast.ids.tolist() == [3, 4, 5, 6]
    assert set(forecast.dropped.values()) == {"compiling"}
    go.set()
    wait(lambda: notices[-1] == "everything is compiled")
    assert gc.get_freeze_count() > 1000
    forecast = push(5)
    assert len(forecast.ids) == 10
    (result,) = forecast.models.values()
    expected = predict(model(), forecast.observed, samples=2, frame=2)
    assert_allclose(result.samples, expected, atol=1e-5)


@pytest.mark.slow
def test_nobody_is_a_forecast_and_who_has_none_is_said_to_be_there(model):
    predictor = Predictor(
        model(), samples=3, max_people=1, compile="needed", min_seen=0.0
    )
    first = predictor.push(0.0, [1, 2], [[0.0, 0.0], [5.0, 0.0]], focus=[0.0, 0.0])
    assert first.ids.tolist() == []
    assert first.dropped == {1: "short", 2: "short"}
    assert_array_equal(first.whereabouts, [[0, 0], [5, 0]])
    second = predictor.push(0.1, [1, 2], [[0.1, 0.0], [5.0, 0.0]], focus=[0.0, 0.0])
    assert second.ids.tolist() == [1]
    assert second.dropped == {2: "crowded"}
    assert_array_equal(second.whereabouts, [[5, 0]])
    nobody = predictor.push(1.0, [], np.zeros((0, 2)))
    assert nobody.dropped == {1: "unseen", 2: "unseen"}
    assert np.isnan(nobody.whereabouts).all()
    (result,) = nobody.models.values()
    assert result.samples.shape == result.draws.shape == (3, 0, 3, 2)
    assert result.regions.radius.shape == (2, 0, 3)


@pytest.mark.slow
def test_draws_keep_their_noise_from_frame_to_frame():
    """Who goes straight on is drawn as before, moved on: nothing but the way changes."""
    predictor = Predictor(load_models([Path("recommended")]), compile="needed")
    ends = []
    for n in range(34):
        forecast = predictor.push(n / 10, [1], [[0.1 * n, 0.0]])
        if len(forecast.ids):
            (result,) = forecast.models.values()
            ends.append(result.draws[:, 0, -1] - [0.1 * n, 0.0])
    assert len(ends) == 6
    assert_allclose(ends, np.broadcast_to(ends[0], np.shape(ends)), atol=2e-3)
    assert np.std(ends[0]) > 0.1


@pytest.mark.slow
def test_a_network_is_told_who_was_just_seen():
    """Its layers for incomplete histories forecast a newcomer; whole windows are as before."""
    models = load_models([Path("recommended")])
    options = {"samples": 4, "max_people": 2, "min_seen": 0.0, "compile": "needed"}
    predictor = Predictor(models, **options)
    for n in range(36):
        people = [1, 2] if n >= 30 else [1]
        way = [[0.1 * n, 0.0], [0.1 * n, 0.5 + 0.05 * (n - 30)]]
        forecast = predictor.push(n / 10, people, way[: len(people)])
        assert forecast is not None
        (result,) = forecast.models.values()
        if n == 29:
            expected = predict(models["recommended"], forecast.observed, samples=4)
            assert_allclose(result.samples, expected, atol=1e-4)

    model = models["recommended"]
    network = SceneForecaster(model.forecaster, model.params, samples=4, seed=0)
    scene = make_scene(forecast.observed, frame=forecast.index - 7)
    scene = pad_scene(scene, 2)
    newcomer = np.arange(8) >= 6
    told = scene.replace(seen=np.stack([np.ones(8, bool), newcomer]))
    assert_allclose(result.samples, network(told), atol=1e-4)
    untold = network(scene)
    assert np.abs(result.samples - untold)[:, 1].max() > 0.1


def test_names_of_models_side_by_side():
    sgan, neurosym = Path("sgan_zara1_8"), Path("neurosym_zara1_8")
    assert list(load_models((neurosym, sgan))) == ["neurosym_zara1_8", "sgan_zara1_8"]
    assert list(load_models((Path("recommended"),))) == ["recommended"]
    names = load_models((sgan, Path("sgan_eth_8")))
    assert list(names) == ["sgan_zara1_8", "sgan_eth_8"]


def test_steps_are_the_models_own(model):
    network = model()
    other = dataclasses.replace(
        network, config=dataclasses.replace(network.config, period=0.2)
    )
    assert (
        Predictor(other, max_people=1, samples=1, compile="needed").window.period == 0.2
    )
    with pytest.raises(InputError, match=r"steps of one length, not \[0\.2, 0\.4\] s"):
        Predictor({"one": network, "other": other})


def resident() -> int:
    """Bytes of memory that this process holds."""
    gc.collect()
    return int(MEMORY.read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")


@pytest.mark.slow
@pytest.mark.skipif(not MEMORY.exists(), reason="memory is read from Linux's /proc")
@pytest.mark.parametrize("minutes", [2, pytest.param(60, marks=pytest.mark.exhaustive)])
def test_people_come_and_go_for_long(model, minutes):
    rng, frames = np.random.default_rng(0), 60 * RATE * minutes
    # Two never leave; the others stay a minute at most, and somebody else comes to
    # their place.
    stay = np.append([frames, frames], rng.integers(30, 600, PEOPLE - 2))
    absent = rng.integers(25, 300, PEOPLE) * (stay < frames)
    place, step = rng.uniform(0, 20, (PEOPLE, 2)), rng.normal(0, 5e-3, (PEOPLE, 2))
    predictor = Predictor(model("as_described"), samples=2, max_people=PEOPLE)
    analytics, compiled = Analytics(predictor), compile_seconds()
    memory, count = [], 0
    for frame in range(frames):
        visit, since = np.divmod(frame, stay + absent)
        present = since < stay
        ids = np.arange(PEOPLE) + PEOPLE * visit
        # It begins at a clock that counts from 1970, with frames that tremble by 2 ms.
        stamp = 1.7e9 + frame / RATE + (2e-3 * np.sin(frame) if frame % 4 else 0.0)
        forecast = predictor.push(
            stamp, ids[present], (place + step * since[:, None])[present]
        )
        analytics.add(forecast)
        if len(forecast.ids):
            count += 1
            # Whose window begins within the trembling of its first frame may have it or
            # not.
            observed_whole, sure = (
                present & (since >= 4 * (OBS - 1) + n) for n in (0, 1)
            )
            assert (
                set(ids[sure]) <= set(forecast.ids.tolist()) <= set(ids[observed_whole])
            )
        if frame % (frames // 6) == frames // 12:
            memory.append(resident())
    assert count >= frames - 4 * (OBS - 1) - 1  # With every frame.
    assert compile_seconds() == compiled
    assert max(memory) - memory[0] < (8e6 if minutes == 60 else 3e6), memory
    health = dict(predictor.health)
    assert health.pop("frames") == frames
    assert health.pop("forgotten") > visit.sum() - PEOPLE
    assert not any(health.values()), health
    summary = analytics.summary()
    assert summary["forecasts"] == count
    assert summary["dropped"].keys() <= {"short", "unseen", "future unknown"}
