"""A predictor of an .onnx file: the numbers of JAX, in a process that has none."""

import functools
import itertools
import os
import re
import signal
import subprocess
import sys
import time

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from rosbags.highlevel import AnyReader

from neurosym_jax.commands import export
from neurosym_jax.errors import InputError
from neurosym_jax.models.anchors import draws
from neurosym_jax.models.anchors.config import AnchorConfig
from neurosym_jax.models.anchors.draws import _lots
from neurosym_jax.models.anchors.draws import draw_scenes as draw_in_jax
from neurosym_jax.models.disk import save_model
from neurosym_jax.scene import make_scene
from neurosym_robot import OnnxModel, Predictor
from neurosym_robot.commands._place_file import open_place
from neurosym_robot.online import coupling
from neurosym_robot.online.predictor import load_models
from neurosym_robot.ros.definitions import (
    FORECAST,
    PEOPLE,
    PEOPLE_TOPICS,
    blank,
    ros1_name,
    typestore,
)
from neurosym_robot.ros.messages import make_people
from neurosym_robot.ros.tcpros import Node, Topic
from neurosym_robot.tracking.following import Frame
from tests.networks import random_model
from tests.repository import ROOT
from tests.robot.ros.tcpros.conftest import Master, wait

pytest.importorskip("onnxruntime", reason="onnxruntime is not installed")
pytest.importorskip("onnx", reason="onnx is not installed")

PERIOD, COUNT = 0.4, 4


@pytest.fixture(scope="module")
def model():
    config = AnchorConfig(8, 12, samples=6, points=8, hidden=8)
    return random_model(config, std=0.1)


@pytest.fixture(scope="module")
def file(model, tmp_path_factory):
    """The model as `neurosym export` writes it."""
    folder = tmp_path_factory.mktemp("onnx")
    save_model(folder / "model", model)
    export.run(folder / "model", folder / "model.onnx", samples=6, points=True)
    return folder / "model.onnx"


def stream():
    """Frames of four people at 10 Hz: two walk together, one comes towards them, one turns."""
    for number in range(95):
        time = number / 10
        places = [
            [time, 0.0],
            [time, 0.6],
            [6.0 - time, 0.3],
            [3 * np.cos(time / 3), 3 * np.sin(time / 3)],
        ]
        yield time, [5, 1, 9, 7], places


def draws_of(points, observed, lots):
    """By JAX, from the random numbers of a key."""
    drawn = jax.jit(draw_in_jax, static_argnums=(3, 4))
    scene = make_scene(observed)
    relative = jnp.asarray(points - scene.origin, jnp.float32)
    return np.asarray(drawn(relative, scene.bare(), lots, 20, PERIOD)) + scene.origin


@pytest.mark.slow
@pytest.mark.parametrize("people", [2, 9, 24])
def test_scenes_are_drawn_as_in_jax(people):
    rng = np.random.default_rng(people)
    start = rng.uniform(-3, 3, (people, 1, 2))
    velocity = rng.normal(0, 0.4, (people, 1, 2))
    start[1], velocity[1] = start[0] + 0.5, velocity[0] + 0.01  # Companions.
    way = start + velocity * np.arange(20)[:, None]
    observed = way[:, :8]
    observed[0, 3] += 5.0  # A tracking error.
    spread = rng.normal(0, 0.1, (6, people, 12, 2)).cumsum(axis=2)
    points = way[:, 8:] + spread

    key = jax.random.key(3)
    first, coupled = jax.random.split(key)
    keys = [first, *(jax.random.fold_in(coupled, sweep) for sweep in range(2))]
    lots = np.array([_lots(key, people, 20, True) for key in keys])
    drawn = coupling.draw_scenes(points, observed, lots, PERIOD)
    expected = draws_of(points, observed, key)
    # A point is chosen anew where a random number lies at its border.
    differs = np.abs(drawn - expected).max(axis=(2, 3)) > 1e-4
    assert differs.mean() < 0.01
    alone = points[(lots[0].T * 6).astype(int), np.arange(people)]
    assert (np.abs(alone - expected).max(axis=(2, 3)) > 1e-4).mean() > 0.1


def test_what_pairs_say_is_what_they_say_in_jax():
    """Three companions, one of them lost at last; and two who run across each other's way."""
    time = np.arange(20)[:, None] * PERIOD
    ways = [[0.0, row] + np.array([0.5, 0.1 * row]) * time for row in (0.0, 0.6, 1.2)]
    # They meet between two steps, at (0, 9).
    ways += [[-13.8, 9.0] + np.array([3.0, 0.0]) * time]
    ways += [[0.0, 22.8] - np.array([0.0, 3.0]) * time]
    ways = np.array(ways)
    ways[1, 7:] += [2.0, -1.0]  # A tracking error.
    rng = np.random.default_rng(0)
    points = ways[:, 8:] + rng.normal(0, 0.05, (6, 5, 12, 2)).cumsum(axis=2)

    scene = make_scene(ways[:, :8])
    relative = jnp.asarray(points - scene.origin, jnp.float32)
    near, present = draws.nearest(relative, jnp.asarray(scene.valid))
    compute = jax.jit(draws.pair_terms, static_argnums=4)
    table, rows = compute(relative, scene.bare(), near, present, PERIOD)
    nats = np.asarray(table[rows])
    expected = np.zeros((5, 5, 6, 6))
    for person, others in enumerate(np.asarray(near)):
        expected[person, others] = nats[person]
    assert expected[0, 1].max() > 0.3
    assert expected[3, 4].max() > 4

    terms = coupling.pair_terms(points.astype(np.float32), ways[:, :8], PERIOD)
    costs = np.zeros_like(expected)
    for person, others in terms.items():
        for term in others:
            costs[person, term.other] = term.cost
    assert_allclose(costs, expected, atol=1e-3)


def test_people_overlap_at_a_single_step():
    points = np.array([[[[0.0, 0.0]], [[0.15, 0.0]]]], np.float32)
    overlap = coupling.overlaps(points, np.array([0]), np.array([1]))
    assert_allclose(overlap, [[[0.5]]], atol=1e-6)


def test_each_lot_has_a_part_of_its_own():
    lots = coupling.even_lots(0, 3, 10)
    assert lots.shape == (3, 3, 10)
    parts = np.sort((lots * 10).astype(int), axis=-1)
    assert_array_equal(parts, np.broadcast_to(np.arange(10), parts.shape))


@pytest.mark.slow
def test_forecasts_are_those_of_jax(model, file):
    options = {"samples": 6, "max_people": COUNT, "compile": "needed", "hold": 1.0}
    options["min_seen"] = 0.0
    reports = []
    ours = Predictor(OnnxModel(file), **options, report=reports.append)
    theirs = Predictor(model, **options)
    assert ours.is_light
    assert not theirs.is_light
    shift = np.array([500.0, -300.0])
    for stamp, ids, places in stream():
        first = ours.push(stamp, ids, places + shift)
        second = theirs.push(stamp, ids, places + shift)
        assert_array_equal(first.ids, second.ids)
        (one,), (other,) = first.models.values(), second.models.values()
        assert_allclose(one.samples, other.samples, atol=1e-4)
        assert one.central == other.central
        if len(first.ids):
            assert_allclose(one.probability, other.probability, atol=1e-5)
    assert not reports  # Nothing is compiled.
    # The draws are of the same distribution, by other random numbers, which stay.
    assert one.draws.shape == other.draws.shape
    last = first.observed[:, -1:]
    size = np.abs(other.draws - last).max()
    assert np.abs(one.draws.mean(axis=0) - other.draws.mean(axis=0)).max() < size / 3
    again = Predictor(OnnxModel(file), **options)
    for frame in stream():
        forecast = again.push(frame[0], frame[1], frame[2] + shift)
    (result,) = forecast.models.values()
    assert_array_equal(result.draws, one.draws)


@pytest.mark.slow
def test_newcomers_are_forecast_as_in_jax(tmp_path):
    """A model that learned from incomplete histories is told which steps were seen."""
    config = AnchorConfig(8, 12, samples=6, points=8, hidden=8, short=True)
    model = random_model(config, std=0.1)
    save_model(tmp_path / "model", model)
    export.run(tmp_path / "model", tmp_path / "m.onnx", samples=6, points=True)
    options = {"samples": 6, "max_people": COUNT, "compile": "needed"}
    options["min_seen"] = 0.0
    ours = Predictor(OnnxModel(tmp_path / "m.onnx"), **options)
    theirs = Predictor(model, **options)
    for stamp, ids, places in itertools.islice(stream(), 40):
        forecasts = [predictor.push(stamp, ids, places) for predictor in (ours, theirs)]
        (one,), (other,) = (forecast.models.values() for forecast in forecasts)
        assert_allclose(one.samples, other.samples, atol=1e-4)


BLOCK = """
import os, sys

class Blocked:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in os.environ["BLOCKED"].split():
            raise ImportError(f"{name} is not here")

sys.meta_path.insert(0, Blocked())
"""
WITHOUT_JAX = f"""{BLOCK}
import numpy as np
from neurosym_robot import Analytics, OnnxModel, PeopleSource, Predictor, Status
from neurosym_robot import KalmanFilter, OnlineStitcher, replay
from neurosym_robot.online.window import Window
from neurosym_robot.ros.ros1 import ForecastNode
from neurosym_robot.tracking.following import Frame

frames = [Frame(*row) for row in np.load(sys.argv[2], allow_pickle=True)]
predictor = Predictor(OnnxModel(sys.argv[1]), samples=6, max_people=4, hold=1.0)
analytics = Analytics(predictor)
status = Status(predictor, analytics)
for event in replay(frames, predictor, analytics, stitcher=OnlineStitcher()):
    status.heard(event.frame.stamp)
    status.published(0.01)
(result,) = event.forecast.models.values()
analytics.finish()
assert "published" in status.table() or "ADE" in status.table(), status.table()
assert "jax" not in sys.modules
np.savez(sys.argv[3], samples=result.samples, radius=result.regions.radius)
"""
JAX = "jax jaxlib flax optax orbax"
COMMAND = f"""{BLOCK}
from neurosym_jax.__main__ import main
main(sys.argv[1:])
"""


@pytest.mark.slow
def test_it_needs_no_jax(model, file, tmp_path):
    """Another process, in which JAX cannot be imported: window, source, tracking, scores, a node."""
    frames = np.empty((95, 3), object)
    for number, row in enumerate(stream()):
        frames[number] = row[0], np.array(row[1]), np.array(row[2])
    np.save(tmp_path / "frames.npy", frames, allow_pickle=True)
    words = [WITHOUT_JAX, file, tmp_path / "frames.npy", tmp_path / "out.npz"]
    command = [sys.executable, "-c", *map(str, words)]
    environment = os.environ | {"BLOCKED": JAX}
    done = subprocess.run(
        command, capture_output=True, text=True, cwd=ROOT, env=environment
    )
    assert done.returncode == 0, done.stderr
    result = np.load(tmp_path / "out.npz")
    options = {"samples": 6, "max_people": COUNT, "compile": "needed", "hold": 1.0}
    predictor = Predictor(model, **options)
    for frame in frames:
        forecast = predictor.push(*frame)
    (expected,) = forecast.models.values()
    assert_allclose(result["samples"], expected.samples, atol=1e-4)
    assert result["radius"].shape == (2, COUNT, 12)
    assert (result["radius"] > 0).all()


def run_without_jax(folder, *words, check=True, others=""):
    """A command in a process in which neither JAX nor `others` can be imported."""
    command = [sys.executable, "-c", COMMAND, *map(str, words)]
    paths = {"PYTHONPATH": str(ROOT), "XDG_CACHE_HOME": str(folder)}
    paths["BLOCKED"] = f"{JAX} {others}"
    done = subprocess.run(
        command, capture_output=True, text=True, cwd=folder, env=os.environ | paths
    )
    assert (done.returncode == 0) == check, done.stderr
    assert not re.search("Traceback|is not here|warning: plugin", done.stderr), (
        done.stderr
    )
    return done


@pytest.fixture
def tracks(tmp_path):
    """The stream as a file."""
    rows = []
    for stamp, ids, places in stream():
        rows += [f"{stamp},{id},{x},{y}\n" for id, (x, y) in zip(ids, places)]
    (tmp_path / "tracks.csv").write_text("t,id,x,y\n" + "".join(rows))
    return tmp_path / "tracks.csv"


@pytest.mark.slow
def test_commands_need_no_jax(file, tracks):
    folder = tracks.parent
    light = ["--model", file, "--samples", 6]
    done = run_without_jax(
        folder, "replay", tracks, *light, "--html", "page.html", "--out", "out.bag"
    )
    assert "published" in done.stdout or "ADE" in done.stdout
    assert '"likely":null' in (folder / "page.html").read_text()
    with AnyReader([folder / "out.bag"]) as bag:
        topics = set(bag.topics)
    assert "/hri/human_poses_prediction/samples" in topics
    assert not any(topic.endswith("/events") for topic in topics)
    # A bag, as a node, needs no library of tables or of assignments.
    heavy = "polars scipy matplotlib"
    run_without_jax(folder, "replay", "out.bag", *light, others=heavy)
    run_without_jax(folder, "stitch", tracks, "--out", "mended.txt")
    for command in ("replay", "ros1", "ros2", "stitch"):
        run_without_jax(folder, command, "--help")
    done = run_without_jax(folder, "ros2", *light, check=False)
    assert "rclpy" in done.stderr
    done = run_without_jax(folder, "ros1", *light, "--name", "a b", check=False)
    assert "a b" in done.stderr
    done = run_without_jax(
        folder, "replay", tracks, *light, "--place", "hall.npz", check=False
    )
    assert "--place learns with a model in JAX" in done.stderr


def test_a_node_needs_no_jax(file, tmp_path):
    """A process that hears people of another node, and publishes their futures until it is stopped."""
    master, store, heard = Master(), typestore(1), []

    def topic(name, kind):
        definition, md5 = store.generate_msgdef(kind, ros_version=1)
        return Topic(name, ros1_name(kind), md5, definition)

    words = ["ros1", "--model", file, "--samples", 6, "--master", master.uri]
    command = [sys.executable, "-c", COMMAND, *map(str, words)]
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    environment["BLOCKED"] = f"{JAX} polars scipy"
    node = Node("peer", master.uri, print)
    people = node.advertise(topic(PEOPLE_TOPICS[0], PEOPLE))
    samples = topic("/hri/human_poses_prediction/samples", FORECAST)
    node.subscribe(samples, lambda data, header: heard.append(data))
    process = subprocess.Popen(command, cwd=tmp_path, env=environment)
    try:
        wait(lambda: people.subscribers, 120)
        for number in range(600):
            stamp = time.time()
            frame = Frame(stamp, np.arange(3), np.eye(3, 2) + number / 10)
            message = make_people(functools.partial(blank, store), frame)
            people.publish(bytes(store.serialize_ros1(message, PEOPLE)))
            time.sleep(0.1)
            if len(heard) > 3:
                break
        forecast = store.deserialize_ros1(heard[-1], FORECAST)
        assert forecast.ids.tolist() == [0, 1, 2]
        assert len(forecast.futures) == forecast.samples * 3 * 12 * 2
        process.send_signal(signal.SIGINT)
        assert process.wait(60) == 0
    finally:
        process.kill()
        node.close()
        master.server.close()


def test_what_cannot_be_is_refused(model, file, tmp_path):
    (tmp_path / "other.onnx").write_text("no model")
    with pytest.raises(InputError, match="not a model that `neurosym export` wrote"):
        OnnxModel(tmp_path / "other.onnx")
    with pytest.raises(InputError, match="exported with 6, not 20"):
        Predictor(OnnxModel(file))
    (loaded,) = load_models([file]).values()
    assert isinstance(loaded, OnnxModel)
    with pytest.raises(InputError, match=r"--place learns with a model in JAX"):
        open_place(tmp_path / "hall.npz", loaded)
    with pytest.raises(InputError, match=r"--points are exported to a file \*.onnx"):
        export.run(file.parent / "model", tmp_path / "x.stablehlo", points=True)
    table = random_model(AnchorConfig(8, 12, samples=6, points=0, hidden=8))
    save_model(tmp_path / "table", table)
    with pytest.raises(InputError, match="has no distribution of its own"):
        export.run(tmp_path / "table", tmp_path / "t.onnx", samples=6, points=True)
