"""A recording replayed is the recording evaluated, from any file, into any file."""

import contextlib
import importlib.util
import io
import itertools
import json
import math
import os
import re
import signal
import subprocess
import sys
import time
from collections import defaultdict
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from unittest import mock

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from neurosym_jax.simulation.scenarios import TrackerFaults
from neurosym_robot.commands import replay as command
from neurosym_robot.commands._live_options import NodeOptions
from neurosym_robot.dashboard.view import View
from neurosym_robot.input.kinds import see
from neurosym_robot.online.replay import replay
from neurosym_robot.ros.bags import read_messages, read_people
from neurosym_robot.ros.definitions import HUMANS, TRUTH_TOPIC, seconds_of
from neurosym_robot.tracking.following import Frame
from tests.repository import exhaustive
from tests.robot.recordings import walkers, write_people

pytest.importorskip("rosbags", reason="rosbags is not installed")

MODELS = (Path("sgan_zara1_8"), Path("neurosym_zara1_8"))
FAULTS = TrackerFaults(dropout=0.01, id_switch=1.0)
TOPICS = {"sgan_zara1_8": "", "neurosym_zara1_8": "_neurosym_zara1_8"}
"""The first model's topics do not name it."""


def run(**options) -> None:
    options["recording"] = (options["recording"],)
    command.run(
        command.Options(**{"model": MODELS, "samples": 3, "max_people": 4, **options})
    )


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    """A bag of 14 s with three people, whom the tracker loses now and then, and its replay."""
    folder = tmp_path_factory.mktemp("bags")
    recording = write_people(folder / "run.db3", walkers(14.0, faults=FAULTS))
    with contextlib.redirect_stdout(io.StringIO()) as output:
        run(
            recording=recording,
            out=folder / "forecasts.mcap",
            html=folder / "page.html",
            min_seen=2.8,
        )
    (folder / "said.txt").write_text(output.getvalue())
    return folder


@pytest.fixture(scope="module")
def replayed(folder) -> dict[str, list]:
    """The messages of every topic."""
    got = defaultdict(list)
    for topic, message in read_messages(folder / "forecasts"):
        got[topic].append(message)
    return got


def futures_of(samples) -> np.ndarray:
    """[K, N, T, 2] places."""
    futures = samples.futures.reshape(samples.samples, -1, samples.steps, 2)
    return futures + samples.position.reshape(-1, 1, 2)


@pytest.mark.slow
def test_the_whole_way_and_back(folder, replayed):
    output = (folder / "said.txt").read_text()
    assert all(
        word in output for word in ("141 frames", "p99", "joint", "future unknown")
    )
    page = (folder / "page.html").read_text()
    rows = [json.loads(line) for line in page.splitlines() if line[:2] == '{"']
    assert rows[0]["models"] == [model.name for model in MODELS]
    assert len(rows) == 1 + 141 + 1
    steps = [line["step"] for line in rows if line.get("step")]
    assert len(steps) > 20
    people = (read_people(folder / name) for name in ("run", "forecasts"))
    for a, b in zip(*people, strict=True):
        assert_array_equal(a.xy, b.xy)
        assert a.stamp == pytest.approx(b.stamp, abs=1e-6)
    for name, topic in TOPICS.items():
        ends = ("", "/samples", "/events")
        heard = [replayed[f"/hri/human_poses_prediction{topic}{end}"] for end in ends]
        assert len({len(messages) for messages in heard}) == 1
        assert len(heard[0]) > 3.5 * len(
            steps
        )  # One with every frame, on the page one a period.
        at = {
            round(seconds_of(messages[0].header.stamp) - 1.7e9, 3): messages
            for messages in zip(*heard)
        }
        for step in steps:
            trajectories, samples, events = at[step["t"]]
            model, futures = step["models"][name], futures_of(samples)
            drawn = (
                np.reshape(model["samples"], (-1, 3, samples.steps, 2)).swapaxes(0, 1)
                / 100
            )
            assert_allclose(
                futures - samples.position.reshape(-1, 1, 2), drawn, atol=6e-3
            )
            assert trajectories.header.frame_id == "odom"
            path = [see(HUMANS, messages) for messages in trajectories.trajs]
            assert [str(id) for id in path[8].ids] == step["ids"]
            way = np.stack([messages.xyz[:, :2] for messages in path[8:]], 1)
            assert_allclose(way, futures[model["central"]], atol=1e-6)
            if name == MODELS[1].name:
                ids = [int(id) for id in step["ids"]]
                rows = {
                    (e.name, e.k, e.l): (e.probability, e.seconds, e.words)
                    for e in events.events
                }
                for kind, k, other, *numbers in step["likely"]:
                    *expected, words = rows[kind, ids[k], ids[other]]
                    assert_allclose(numbers, expected, atol=6e-4)
                    assert words.endswith(
                        f": {100 * expected[0]:.0f} %, in {expected[1]:.1f} s"
                    )


def test_when_people_leave_every_frame_says_so(tmp_path, capsys):
    """They leave at 4 s; for a second they are expected to go on, then nobody is there."""
    frames = walkers(8.0)
    left = [frame._replace(ids=frame.ids[:0], xy=frame.xy[:0]) for frame in frames[40:]]
    recording = write_people(tmp_path / "leave.bag", [*frames[:40], *left])
    run(recording=recording, model=MODELS[:1], out=tmp_path / "out.bag")
    got = defaultdict(list)
    for topic, message in read_messages(tmp_path / "out.bag"):
        got[topic].append(message)
    base = "/hri/human_poses_prediction"
    expected = [round(frame.stamp, 3) for frame in frames]
    for end in ("", "/samples", "/costmap", "/events"):
        stamps = [round(seconds_of(m.header.stamp), 3) for m in got[base + end]]
        assert stamps == expected
    people = np.array([len(message.ids) for message in got[f"{base}/samples"]])
    # Nobody can be forecast when seen once; those seen are listed with their places.
    assert people[0] == 0
    first = got[f"{base}/samples"][0]
    assert (first.other_ids.tolist(), first.other_reason) == ([0, 1, 2], ["short"] * 3)
    assert_allclose(first.other_position.reshape(3, 2), frames[0].xy, atol=1e-6)
    assert (people[1:50] == 3).all()
    assert (people[51:] == 0).all()
    fullest = [message.data.max(initial=0) for message in got[f"{base}/costmap"]]
    assert (min(fullest[:50]), max(fullest[51:])) == (100, 0)
    empty = got[base][-1]
    assert [len(step.humans) for step in empty.trajs] == [0] * 16
    assert "81 frames, 49 forecasts" in capsys.readouterr().out.replace("50", "49")


@pytest.mark.slow
def test_stitched_people_are_written_under_their_mended_ids(folder, tmp_path, capsys):
    """The tracker knows three people by more ids; stitched, they are nearly three again."""
    options = {"out": tmp_path / "mended.bag", "robot_frame": "base_link"}
    if importlib.util.find_spec("foxglove"):
        options["foxglove"] = tmp_path / "scene.mcap"
    run(recording=folder / "run", model=MODELS[:1], stitch=True, **options)
    before = ids_of(read_people(folder / "run"))
    after = ids_of(read_people(tmp_path / "mended.bag"))
    assert 3 <= len(after) <= 4 < len(before)
    messages = [message for _, message in read_messages(tmp_path / "mended.bag")]
    assert ids_of(m for m in messages if hasattr(m, "futures")) == after
    output = capsys.readouterr().out
    assert "until interrupted" not in output
    wrong = output.partition("wrong with the stream: ")[2]
    assert "robot's place unknown" in wrong
    assert "tracks joined" in wrong
    if "foxglove" in options:
        assert "Foxglove can open" in output
        reader = pytest.importorskip("mcap.reader", reason="mcap is not installed")
        with options["foxglove"].open("rb") as file:
            counts = (
                reader.make_reader(file).get_summary().statistics.channel_message_counts
            )
        assert (
            list(counts.values()).count(141) == 2
        )  # Scenes and numbers, beside events.


def ids_of(messages):
    """All ids in them."""
    return set(itertools.chain(*(message.ids.tolist() for message in messages)))


class Slow(View):
    """Takes long to show a frame."""

    title = where = "slow"

    def __init__(self, seconds: float):
        self.seconds, self.stamps, self.ends = seconds, [], 0

    def show(self, event, now):
        time.sleep(self.seconds)
        self.stamps.append(event.frame.stamp)

    def end(self, score, scored=()):
        self.ends += 1


@pytest.mark.slow
def test_a_slow_view_delays_no_frame_in_real_time_and_has_every_one_otherwise(
    folder, capsys
):
    frames = [frame.stamp for frame in read_people(folder / "run")]
    for rate, seconds in ((40, 0.3), ("max", 0.0)):
        slow = Slow(seconds)

        class WithSlowView(command.Options):
            def views(self, *_, view=slow):
                return [view]

        began = time.monotonic()
        options = {"recording": (folder / "run",), "model": MODELS[:1], "rate": rate}
        command.run(WithSlowView(**options, samples=3, max_people=4))
        assert rate == "max" or slow.seconds * len(frames) > time.monotonic() - began
        assert (slow.stamps[-1], slow.ends) == (frames[-1], 1)
        assert (slow.stamps == frames) == (rate == "max")
        words = re.search(
            r"p99 ([\d.]+) ms, at most ([\d.]+) ms", capsys.readouterr().out
        )
        assert words
        assert 0 < float(words[1]) <= float(words[2]) < 4e3


def test_slow_views_do_not_hold_a_node_up(monkeypatch):
    slow = Slow(0.2)

    class WithSlowView(NodeOptions):
        def views(self, *_):
            return [slow]

    options = WithSlowView(model=MODELS)
    monkeypatch.setattr("signal.signal", lambda *_: None)
    node: Any = mock.MagicMock(views=[])
    frames = [SimpleNamespace(frame=SimpleNamespace(stamp=n)) for n in range(50)]
    node.run = lambda: [
        view.show(frame, {}) for frame, view in itertools.product(frames, node.views)
    ]
    began = time.monotonic()
    options.forecast(node)
    assert time.monotonic() - began < 2
    assert slow.stamps[-1] == 49


@pytest.mark.parametrize("name", TOPICS)
def test_the_table_is_the_errors_of_what_is_written(folder, replayed, name):
    topic = f"/hri/human_poses_prediction{TOPICS[name]}/samples"
    forecasts = {
        seconds_of(message.header.stamp): message for message in replayed[topic]
    }
    ade, published, people = 0.0, 0.0, 0
    for truth in replayed[TRUTH_TOPIC]:
        steps = [see(HUMANS, step) for step in truth.trajs[8:]]
        samples = forecasts[seconds_of(truth.header.stamp)]
        rows = [samples.ids.tolist().index(id) for id in steps[0].ids.tolist()]
        off = futures_of(samples)[:, rows] - np.stack(
            [step.xyz[:, :2] for step in steps], 1
        )
        errors = np.linalg.norm(off, axis=-1).mean(axis=-1).sum(axis=1)
        ade, published = ade + errors.min(), published + errors[samples.central]
        people += len(rows)
    output = (folder / "said.txt").read_text().splitlines()
    (line,) = [line for line in output if line.strip().startswith(name)]
    assert float(line.split()[1]) == pytest.approx(published / people, abs=2e-3)
    assert float(line.split()[3]) == pytest.approx(ade / people, abs=2e-3)
    assert int(line.split()[-1]) == people > 10


def test_the_rate_is_that_of_the_stamps():
    idle = SimpleNamespace(  # A predictor, and its analytics, that forecast nothing.
        waited=0.0,
        learn=lambda: None,
        window=SimpleNamespace(push=lambda *_, **__: True),
        forecast=lambda *_, **__: None,
        add=lambda forecast: [],
    )
    stamps = [0.0, 0.1, 0.4, 0.3, math.nan, 0.5]
    frames = [Frame(stamp, np.zeros(0, np.int64), np.zeros((0, 2))) for stamp in stamps]
    for rate, seconds in ((2.0, 0.3), (math.inf, 0.0)):
        before = time.monotonic()
        events = list(replay(frames, idle, idle, rate=rate))
        assert seconds - 1e-3 <= time.monotonic() - before < seconds + 0.2
        assert [event.frame for event in events] == frames
    # The recording is opened, or without a rate read, in nobody's time.
    for rate, slow in ((2.0, {0}), (math.inf, {0, 3})):
        read = (
            time.sleep(0.2 * (n in slow)) or frame for n, frame in enumerate(frames)
        )
        assert all(
            -0.01 < event.age < 0.1 for event in replay(read, idle, idle, rate=rate)
        )


@pytest.mark.slow
@pytest.mark.parametrize(
    ("number", "status", "options"),
    [
        (signal.SIGINT, 130, ["--dashboard", "--port", "0"]),
        (signal.SIGTERM, 143, ["--rate", "1", "--out", "part.mcap"]),
        exhaustive(signal.SIGHUP, 129, ["--rate", "1"]),
    ],
)
def test_the_first_signal_ends_it_and_says_what_is_only_a_part(
    folder, tmp_path, number, status, options
):
    if signal.getsignal(number) is signal.SIG_IGN:
        pytest.skip("the tests run in the background, where this signal is ignored")
    command = [
        sys.executable,
        "-m",
        "neurosym_jax",
        "replay",
        folder / "run",
        "--samples",
        "3",
    ]
    process = subprocess.Popen(
        [*command, "--model", MODELS[0], *options],
        cwd=tmp_path,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    assert process.stderr is not None
    line = "begun"
    while "compiling for up to 4" not in line:
        assert line, process.communicate()
        line = process.stderr.readline()
    time.sleep(6)  # 2.8 s of the recording, and the compiler
    process.send_signal(number)
    began = time.monotonic()
    output, _ = process.communicate(timeout=30)
    assert process.returncode == status
    assert time.monotonic() - began < 2 * (
        1 + os.getloadavg()[0] / (os.cpu_count() or 1)
    )
    assert "until the interruption:" in output
    if "--out" in options:
        assert "forecasts are in part, up to the interruption only" in output
        stamps = [frame.stamp for frame in read_people(tmp_path / "part")]
        assert 0 < len(stamps) < 141
