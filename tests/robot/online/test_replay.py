"""A recording replayed is the recording evaluated, from any file, into any file."""

import json
import math
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from neurosym_jax.data.reading import ReadOptions
from neurosym_jax.errors import InputError
from neurosym_jax.simulation.scenarios import simulate
from neurosym_jax.simulation.tracker import TrackerFaults
from neurosym_robot.commands import replay as replay_verb
from neurosym_robot.online.frames import Frame, frames_of_tracks
from neurosym_robot.online.replay import replay
from neurosym_robot.ros import messages
from neurosym_robot.ros.bag_writer import BagWriter
from neurosym_robot.ros.bags import read_messages, read_people
from neurosym_robot.ros.definitions import HUMANS, TRUTH_TOPIC
from neurosym_robot.ros.people import seconds_of, see

pytest.importorskip("rosbags", reason="rosbags is not installed")

SHIPPED = Path(__file__).resolve().parents[3] / "checkpoints"
MODELS = [str(SHIPPED / name) for name in ("sgan_zara1_8", "neurosym_zara1_8")]
FAULTS = TrackerFaults(dropout=0.01, id_switch=1.0)


class Still:
    """A predictor, and its analytics, that forecast nothing."""

    waited = 0.0

    def observe(self, stamp, ids, xy, focus=None):
        return True

    def forecast(self, focus=None):
        return None

    def add(self, forecast):
        return []


def run(*arguments) -> subprocess.CompletedProcess:
    command = [sys.executable, "-m", "neurosym_jax", "replay", *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True)


@pytest.fixture(scope="module")
def recording(tmp_path_factory) -> Path:
    """A bag of 14 s with three people, whom the tracker loses now and then."""
    tracks = simulate("cross-path", 1, 14.0, people=3, faults=FAULTS)
    with BagWriter(tmp_path_factory.mktemp("bags") / "run.db3") as bag:
        for frame in frames_of_tracks(tracks):
            frame = frame._replace(stamp=frame.stamp + 1.7e9)
            bag.write("/people", frame.stamp, messages.make_people(bag.new, frame, "odom"))
    return bag.path


def test_the_whole_way_and_back(recording, tmp_path):
    bag, page = tmp_path / "forecasts.bag", tmp_path / "replay.html"
    few = ["--samples", 3, "--max-people", 4]
    done = run(recording, "--model", *MODELS, *few, "--out", bag, "--html", page)
    assert done.returncode == 0, done.stderr
    assert all(word in done.stdout for word in ("141 frames", "p99", "joint", "future unknown"))
    told = [json.loads(line) for line in page.read_text().splitlines() if line[:2] == '{"']
    assert told[0]["models"] == ["SGAN", "NeuroSyM"]
    assert len(told) == 1 + 141 + 1
    steps = [line["step"] for line in told if line.get("step")]
    assert len(steps) > 20
    got: dict[str, list] = {}
    for topic, message in read_messages(bag):
        got.setdefault(topic, []).append(message)
    for a, b in zip(read_people(recording), read_people(bag), strict=True):
        assert_array_equal(a.xy, b.xy)
        assert a.stamp == pytest.approx(b.stamp, abs=1e-6)
    for name, topic in (("NeuroSyM", "neurosym"), ("SGAN", "baseline")):
        ends = ("", "/samples", "/events")
        heard = [got[f"/hri/human_poses_prediction_{topic}{end}"] for end in ends]
        assert len({len(each) for each in heard}) == 1
        assert len(heard[0]) > 3.5 * len(steps)  # One with every frame, on the page one a period.
        at = {round(seconds_of(each[0].header.stamp) - 1.7e9, 3): each for each in zip(*heard)}
        for step in steps:
            trajectories, samples, events = at[step["t"]]
            model = step["models"][name]
            futures = samples.futures.reshape(3, -1, samples.steps, 2)
            shown = np.reshape(model["samples"], (-1, 3, samples.steps, 2)).swapaxes(0, 1) / 100
            assert_allclose(futures, shown, atol=6e-3)
            assert trajectories.header.frame_id == "odom"
            path = [see(HUMANS, each) for each in trajectories.trajs]
            assert [str(id) for id in path[8].ids] == step["ids"]
            future = futures[model["central"]] + samples.position.reshape(-1, 1, 2)
            assert_allclose(np.stack([each.xy for each in path[8:]], 1), future, atol=1e-6)
            if name == "NeuroSyM":
                ids = [int(id) for id in step["ids"]]
                kinds = {(each[0], ids[each[1]], ids[each[2]]) for each in step["likely"]}
                assert kinds <= {(each.name, each.k, each.l) for each in events.events}


def test_the_table_is_the_errors_of_what_is_written(recording, tmp_path):
    out = tmp_path / "forecasts.mcap"
    few = ["--samples", 3, "--max-people", 4]
    done = run(recording, "--model", MODELS[0], *few, "--out", out, "--stitch")
    got = {topic: {} for topic in (TRUTH_TOPIC, "/hri/human_poses_prediction_baseline/samples")}
    for topic, message in read_messages(out.with_suffix("")):
        if topic in got:
            got[topic][seconds_of(message.header.stamp)] = message
    truths, forecasts = got.values()
    ade, people = 0.0, 0
    for stamp, truth in truths.items():
        steps = [see(HUMANS, step) for step in truth.trajs[8:]]
        samples = forecasts[stamp]
        rows = [samples.ids.tolist().index(id) for id in steps[0].ids.tolist()]
        futures = samples.futures.reshape(3, -1, 8, 2) + samples.position.reshape(-1, 1, 2)
        off = futures[:, rows] - np.stack([step.xy for step in steps], 1)
        ade += np.linalg.norm(off, axis=-1).mean(axis=-1).sum(axis=1).min()
        people += len(rows)
    (line,) = [line for line in done.stdout.splitlines() if line.strip().startswith("SGAN")]
    assert float(line.split()[1]) == pytest.approx(ade / people, abs=2e-3)
    assert int(line.split()[-1]) == people > 10


def test_what_is_wrong_is_one_line(recording, tmp_path):
    text = tmp_path / "tracks.txt"
    text.write_text("0 1 0 0\n10 1 x 0\n")
    there = tmp_path / "there.bag"
    there.touch()
    cases: list[tuple[dict, str]] = [
        (
            {"read": ReadOptions(format="bag,topic=/nobody")},
            "/nobody is not there",
        ),
        ({"recording": text}, "row 2"),
        ({"recording": tmp_path / "none.bag"}, "no such file"),
        ({"out": there}, "already there"),
        ({"out": tmp_path / "forecasts.csv"}, "ends in .bag"),
        ({"rate": 0.0}, "rate must be positive"),
    ]
    usual = {"recording": recording, "model": (Path(MODELS[0]),), "max_people": 4, "samples": 2}
    for changed, reason in cases:
        with pytest.raises(InputError) as error:
            replay_verb.run(replay_verb.Options(**{**usual, **changed}))
        assert reason in str(error.value)
        assert "\n" not in str(error.value)
    done = run(text, "--model", MODELS[0])
    assert done.returncode == 2
    assert done.stderr.startswith("error: ")


def test_the_rate_is_that_of_the_stamps():
    stamps = [0.0, 0.1, 0.4, 0.3, math.nan, 0.5]
    frames = [Frame(stamp, np.zeros(0, np.int64), np.zeros((0, 2))) for stamp in stamps]
    for rate, seconds in ((2.0, 0.3), (math.inf, 0.0)):
        before = time.monotonic()
        events = list(replay(frames, Still(), Still(), rate=rate))  # pyright: ignore
        assert seconds - 1e-3 <= time.monotonic() - before < seconds + 0.2
        assert [event.frame for event in events] == frames
    with pytest.raises(InputError, match="rate"):
        list(replay(frames, Still(), Still(), rate=math.nan))  # pyright: ignore
