"""Whatever a stream holds, the chain from message to forecast goes on and stays small."""

import contextlib
import itertools
import random
import struct
import time
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from neurosym_jax.errors import InputError
from neurosym_robot.input.source import PeopleSource
from neurosym_robot.online.predictor import Predictor
from neurosym_robot.online.replay import Analytics, advance
from neurosym_robot.ros import forecasting_node as forecasting
from neurosym_robot.ros import messages
from neurosym_robot.ros.definitions import FORECAST, PEOPLE, PEOPLE_TOPICS, blank
from neurosym_robot.ros.forecasting_node import WAITING, Outlet
from neurosym_robot.ros.ros1 import ForecastNode
from neurosym_robot.ros.tcpros.wire import SlaveServer
from neurosym_robot.tracking.following import Frame
from neurosym_robot.tracking.stitching import OnlineStitcher
from tests.compiling import compile_seconds
from tests.robot.input.robot import transform

STEPS = (
    0.1,
    0.1,
    0.1,
    0.1,
    0.1,
    0.0,
    -0.05,
    1.5,
    -20.0,
    50.0,
    1e6,
    -1e6,
    np.nan,
    -np.inf,
)


def random_frames(seed: int, length: int):
    """Streams that now and then behave, so that there is something to forecast."""
    rng = np.random.default_rng(seed)
    now, calm = 0.0, 0
    for _ in range(length):
        calm = calm - 1 if calm else rng.choice([0, 0, 0, 30])
        step = 0.1 if calm else rng.choice(STEPS)
        now += step if np.isfinite(step) else 0.0
        ids: Any = np.arange(rng.integers(0, 12) if calm else 5)
        xy = rng.normal(0, 0.3, (len(ids), 2)) + now % 100
        if not calm:
            odd = (ids, -ids, ids * 0, ids + 2**62)
            ids = odd[rng.integers(len(odd))]
            xy *= rng.choice([1, 1e6, 1e30, np.nan, np.inf])
        yield now if np.isfinite(step) else step, ids, xy


@pytest.mark.slow
@pytest.mark.parametrize("stitch", [False, True])
def test_random_streams_never_crash_the_chain(model, stitch):
    predictor = Predictor(model(), samples=2, max_people=8, max_tracks=10)
    stitcher = OnlineStitcher(max_tracks=10) if stitch else None
    analytics, compiled, forecasts = Analytics(predictor), compile_seconds(), 0
    for stamp, ids, xy in random_frames(0, 1000):
        frame = Frame(stamp, ids, xy)
        if stitcher is not None:
            frame = stitcher.mend(frame)
        forecast = advance([frame], predictor).forecast
        scored = analytics.add(forecast)
        if forecast is None or not len(forecast.ids):
            continue
        forecasts += 1
        (result,) = forecast.models.values()
        assert np.isfinite(result.samples).all()
        assert len(forecast.ids) + len(forecast.dropped) <= 10
        assert "compiling" not in forecast.dropped.values()
        assert all(done.future is not None for done in scored)
        assert analytics.summary()["pending"] < 10
    assert forecasts > 100
    assert compile_seconds() == compiled
    health = dict(predictor.health)
    assert stitch or all(health.values()), health


def people(node: ForecastNode, frame: Frame) -> bytes:
    store = node._store
    return bytes(store.serialize_ros1(messages.make_people(node._new, frame), PEOPLE))


FRAME = Frame(10.0, np.array([1]), np.array([[2.0, 0.0]]))
HEADER = {"type": "people_msgs/People", "md5sum": "", "callerid": "/tracker"}


def work(node: ForecastNode, *messages: bytes) -> None:
    """Let the node work on messages that wait."""
    for data in messages:
        node.hear(data, HEADER)
    node.work()


@pytest.mark.slow
def test_mended_people_are_published_with_their_velocities(forecast_node):
    node, back = forecast_node(stitcher=OnlineStitcher(), topic="raw"), []
    node._mended = Outlet(back.append, lambda: True)
    for n in range(40):
        # The tracker loses person 1 for half a second and takes them for somebody new.
        ids = np.array(
            [1 if n < 20 else 7, 2][: 1 + (n % 2)] if not 20 <= n < 25 else [2]
        )
        xy = np.stack([np.full(len(ids), n / 10), np.where(ids == 2, 5.0, 0.0)], axis=1)
        message = messages.make_people(node._new, Frame(1e9 + n / 10, ids, xy), "odom")
        node.put(PEOPLE, message)
        node.work()
    people = itertools.chain(*(message.people for message in back))
    assert {person.name for person in people} == {"1", "2"}
    assert [len(message.people) for message in back[:20]] == 10 * [1, 2]
    for person in back[-1].people:  # at 1 m/s along x
        assert person.velocity.x == pytest.approx(1.0, abs=1e-6)
    assert back[-1].header.frame_id == "odom"
    assert "tracks joined 1" in node.status.line()
    with pytest.raises(InputError, match="--topic must be another"):
        forecast_node(stitcher=OnlineStitcher(), topic=PEOPLE_TOPICS[0])


def broken(data: bytes, rng: random.Random) -> bytes:
    """`data` with a few bytes changed, cut out, put in, or with another length in it."""
    changed = bytearray(data)
    for _ in range(rng.randrange(1, 4)):
        at, count = rng.randrange(len(changed) - 8), rng.randrange(1, 8)
        choice = rng.randrange(4)
        if choice == 0:
            changed[at] = rng.randrange(256)
        elif choice == 1 and len(changed) > 50:
            del changed[at : at + count]
        elif choice == 2:
            changed[at:at] = rng.randbytes(count)
        else:
            changed[at : at + 4] = struct.pack(
                "<I", rng.getrandbits(32) >> rng.randrange(32)
            )
    return bytes(changed)


def test_broken_messages_are_counted_and_the_next_one_is_forecast(forecast_node):
    rng, node = random.Random(0), forecast_node()
    for n in range(300):
        work(node, rng.randbytes(rng.randrange(100)))
        message = people(node, Frame(1e9 + n, np.arange(3), np.full((3, 2), np.nan)))
        work(node, broken(message, rng))
    malformed = node.source.refused["malformed"]
    assert malformed > 400
    for stamp in (2**31 - 5, -100):  # ROS has no time for their forecasts.
        work(node, people(node, Frame(stamp, np.arange(3), np.ones((3, 2)))))
    assert node.source.refused["malformed"] == malformed + 2
    for n in range(20):
        work(node, people(node, Frame(2e9 + n / 10, np.arange(3), np.ones((3, 2)) * n)))
    assert node.analytics.forecasts > 0
    assert "malformed" in node.status.line()


def test_under_load_the_newest_frame_wins_and_what_is_skipped_is_counted(
    forecast_node, monkeypatch
):
    """All frames that wait are observed, so that the forecast is that of a node that kept up."""
    idle, loaded = (forecast_node(name=name) for name in ("idle", "loaded"))
    sent: dict[str, list[Any]] = {"idle": [], "loaded": []}
    ways = np.array([[[n / 10, 0.0], [0.0, n / 10]] for n in range(40)])
    frames = [Frame(1e9 + n / 10, np.array([1, 2]), xy) for n, xy in enumerate(ways)]
    walk = [people(idle, frame) for frame in frames]
    for node, batch in ((idle, 1), (loaded, 5)):
        heard = Outlet(sent[node.name[1:]].append, lambda: True)
        node._forecasts = [
            (output, heard) for output, _ in node._forecasts if output.kind == FORECAST
        ]
        for n in range(0, 40, batch):
            work(node, *walk[n : n + batch])
    assert [len(forecast) for forecast in sent.values()] == [40, 8]
    for message in sent["loaded"]:
        (same,) = (
            forecast
            for forecast in sent["idle"]
            if forecast.header.stamp == message.header.stamp
        )
        assert_array_equal(same.futures, message.futures)
    assert (idle.status.skipped, loaded.status.skipped) == (0, 32)
    assert "skipped 32" in loaded.status.line()
    # The stamps are long past.
    assert loaded.status.now()["age"] > 0
    # More than may wait are counted, too; the newest are kept, and no gap is long.
    clock = SimpleNamespace(monotonic=lambda: n / 30)
    monkeypatch.setattr(forecasting, "time", clock)
    for n in range(1000):
        loaded.put(PEOPLE, n)
        waiting = [forecast[1] for forecast in loaded._waiting]
        assert loaded.source.refused["late"] == n + 1 - len(waiting)
        assert len(waiting) <= WAITING
        assert waiting[-1] == n
        assert max(np.diff(waiting), default=0) <= 4
    assert waiting[0] < 1000 - 30 * 2


def test_the_robot_is_where_it_is_at_the_newest_frame(forecast_node):
    source = PeopleSource("map", print, "base")
    node = forecast_node(name="driving", source=source)
    events: list[Any] = []
    node.views.append(SimpleNamespace(show=lambda event, now: events.append(event)))
    for stamp in (1.0, 2.0):
        node._move(False, transform(stamp, "map", "base", 3 * stamp))
    walk = [
        messages.make_people(node._new, FRAME._replace(stamp=stamp), "map")
        for stamp in (1.0, 2.0)
    ]
    work(node, *(bytes(node._store.serialize_ros1(said, PEOPLE)) for said in walk))
    assert [event.robot.tolist() for event in events] == [[6, 0, 0]]


@pytest.mark.parametrize(("late", "count"), [(0.3, 1), (1.5, 0)])
def test_people_wait_for_tf_by_the_clock_of_a_simulation(forecast_node, late, count):
    """/tf comes `late` seconds after people, however long that takes on this computer."""
    source = PeopleSource("map", report=lambda text: None)
    node = forecast_node(name="simulated", source=source)
    for now in (9.9, 10.0):
        clock = blank(node._store, "rosgraph_msgs/msg/Clock")
        clock.clock.sec, clock.clock.nanosec = divmod(round(now * 1e9), 10**9)
        node._set_clock(clock)
        node._move(False, transform(9.9, "map", "laser", 1.0))
    message = messages.make_people(node._new, FRAME, "laser")
    work(node, bytes(node._store.serialize_ros1(message, PEOPLE)))
    time.sleep(1.2)
    node.work()
    assert node.predictor.health["frames"] == 0
    clock.clock.sec, clock.clock.nanosec = divmod(round((10 + late) * 1e9), 10**9)
    node._set_clock(clock)
    if late > 1:
        node.work()
    node._move(False, transform(10.1, "map", "laser", 1.0))
    node.work()
    assert node.predictor.health["frames"] == count
    assert source.refused["no transform"] == 1 - count


@pytest.fixture
def forecast_node(model):
    """`forecast_node(**options)` is our node, with a master that knows nobody."""
    pytest.importorskip("rosbags", reason="rosbags is not installed")
    with contextlib.ExitStack() as stack:

        def make(**options: Any) -> ForecastNode:
            master = SlaveServer("127.0.0.1", {})
            stack.callback(master.close)
            uri = f"http://127.0.0.1:{master.server_address[1]}"
            predictor = Predictor(
                {"SGAN": model()}, samples=2, max_people=4, compile="needed"
            )
            node = ForecastNode(predictor, master=uri, **options)
            stack.callback(node.close)
            return node

        yield make
