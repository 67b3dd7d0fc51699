"""Messages carry what went in, and are those that robots speak."""

import dataclasses
import functools
import re
import xml.etree.ElementTree as ElementTree
from types import SimpleNamespace

import numpy as np
import pytest
import yaml
from numpy.testing import assert_allclose, assert_array_equal

from neurosym_robot.commands.ros1 import Options
from neurosym_robot.input.kinds import see
from neurosym_robot.online.predictor import Forecast, ModelForecast
from neurosym_robot.ros import messages, ros2
from neurosym_robot.ros.definitions import (
    HUMANS,
    HUMANS_TRAJS,
    MARKERS,
    PEOPLE,
    blank,
    seconds_of,
    typestore,
)
from neurosym_robot.ros.ros1 import Decoder
from tests.repository import ROOT
from tests.robot.forecasts import made_forecast

pytest.importorskip("rosbags", reason="rosbags is not installed")

from rosbags.typesys import get_types_from_msg


@pytest.fixture(params=[1, 2], ids=["ros1", "ros2"], scope="module")
def store(request):
    return typestore(request.param)


@pytest.fixture
def new(store):
    return functools.partial(blank, store)


@pytest.fixture(scope="module")
def forecast() -> Forecast:
    rng = np.random.default_rng(0)
    samples = 5e5 + rng.normal(size=(6, 2, 4, 2))
    observed = 5e5 + rng.normal(size=(2, 3, 2))
    result = ModelForecast(samples, samples.mean(axis=0), 3)
    ids, lost = np.array([4, -8]), np.array([0, 1])
    return made_forecast(
        observed, {"SGAN": result}, stamp=100.5, index=9, ids=ids, extrapolated=lost
    )


def received(store, message, kind=None):
    """What comes out at the other side, whose type is `kind`."""
    name = message.__msgtype__
    if "seq" in vars(blank(store, "std_msgs/msg/Header")):
        return store.deserialize_ros1(store.serialize_ros1(message, name), kind or name)
    return store.deserialize_cdr(store.serialize_cdr(message, name), kind or name)


def test_the_checksums_are_those_of_the_robot():
    store = typestore(1)
    expected = {
        PEOPLE: "18722f4b8db20cc2369740732357847b",
        HUMANS_TRAJS: "2c66d20bf906f8b179d4c4d91ac92096",
    }
    for name, checksum in expected.items():
        assert store.generate_msgdef(name)[1] == checksum


def test_a_forecast_is_the_observed_and_the_most_central_future(store, new, forecast):
    message = received(
        store, messages.forecast_message(new, forecast, "SGAN", 0.4, "odom")
    )
    frames = [see(HUMANS, step) for step in message.trajs]
    assert seconds_of(message.header.stamp) == 100.5
    assert message.header.frame_id == "odom"
    assert_allclose([frame.stamp for frame in frames], 100.5 + 0.4 * np.arange(-2, 5))
    samples = forecast.models["SGAN"].samples
    path = np.concatenate([forecast.observed, samples[3]], axis=1)
    for n, frame in enumerate(frames):
        assert frame.ids.tolist() == [4, -8]
        assert_array_equal(frame.xyz[:, :2], path[:, n])
    speed = np.gradient(path, 0.4, axis=1)[1, 4]
    twist = message.trajs[4].humans[1].velocity.twist.linear
    assert_allclose((twist.x, twist.y), speed)
    covariance = message.trajs[6].humans[1].centroid.covariance.reshape(6, 6)
    assert_allclose(covariance[:2, :2], np.cov(samples[:, 1, 3].T, bias=True))
    assert [human.confidence for human in message.trajs[6].humans] == [
        1,
        pytest.approx(2 / 3),
    ]
    assert {human.centroid.pose.orientation.w for human in message.trajs[6].humans} == {
        1
    }
    assert not message.trajs[2].humans[1].centroid.covariance.any()


def test_the_truth_is_of_those_seen_to_the_end(new, forecast):
    future = np.random.default_rng(1).normal(size=(2, 4, 2))
    future[0, 3] = np.nan
    message = messages.truth_message(
        new, dataclasses.replace(forecast, future=future), 0.4
    )
    frames = [see(HUMANS, step) for step in message.trajs]
    assert seconds_of(message.header.stamp) == 100.5
    assert [frame.ids.tolist() for frame in frames] == [[-8]] * 7
    assert_array_equal(np.stack([frame.xyz[0, :2] for frame in frames[3:]]), future[1])
    nobody = dataclasses.replace(forecast, future=np.full_like(future, np.nan))
    assert messages.truth_message(new, nobody, 0.4) is None


def test_all_samples_compactly(store, new, forecast):
    message = received(
        store, messages.samples_message(new, forecast, "SGAN", 0.4, "map")
    )
    assert (message.model, message.period, message.central) == ("SGAN", 0.4, 3)
    assert (message.header.stamp.sec, message.header.frame_id) == (100, "map")
    assert_array_equal(message.ids, [4, -8])
    assert_array_equal(message.extrapolated, [0, 1])
    position = message.position.reshape(2, 2)
    futures = message.futures.reshape(message.samples, 2, message.steps, 2)
    # Far from the origin, too, to the hair's breadth.
    assert_allclose(
        position[:, None] + futures, forecast.models["SGAN"].samples, rtol=0, atol=1e-6
    )
    walked = (forecast.observed[:, -1] - forecast.observed[:, -2]) / 0.4
    assert_allclose(message.velocity.reshape(2, 2), walked, rtol=1e-5)
    assert message.weights.sum() == pytest.approx(1)


def test_probabilities_are_of_the_draws_where_there_are_any(store, new, forecast):
    """The samples cover what may happen; costmaps and covariances need the distribution."""
    samples = forecast.models["SGAN"].samples
    draws = samples[:, :, :, ::-1] * 2
    result = ModelForecast(
        samples, samples.mean(axis=0), 3, np.full(6, 1 / 6), 0.0, lambda: draws
    )
    drawn = dataclasses.replace(forecast, models={"SGAN": result})
    message = received(store, messages.samples_message(new, drawn, "SGAN", 0.4, "map"))
    assert (message.samples, message.central) == (7, 6)
    assert_allclose(message.weights, [*[1 / 6] * 6, 0])
    futures = message.futures.reshape(7, 2, message.steps, 2)
    expected = np.concatenate([draws, samples[3:4]]) - forecast.observed[:, -1:]
    assert_allclose(futures, expected, rtol=1e-6)
    made = messages.forecast_message(new, drawn, "SGAN", 0.4, "odom")
    covariance = (
        received(store, made).trajs[6].humans[1].centroid.covariance.reshape(6, 6)
    )
    assert_allclose(covariance[:2, :2], np.cov(draws[:, 1, 3].T, bias=True))


def test_a_line_a_person_in_their_own_colour_and_faint_while_unseen(
    store, new, forecast
):
    made = messages.markers_message(new, forecast, "SGAN", 0.4, "odom")
    message = received(store, made, MARKERS)
    clear, *lines = message.markers
    assert clear.action == clear.DELETEALL
    assert [marker.ns for marker in lines] == ["SGAN/4", "SGAN/-8"]
    colours = [(line.color.r, line.color.g, line.color.b) for line in lines]
    # Blue and vermilion of Okabe and Ito.
    assert_allclose(colours, np.array([(0, 114, 178), (213, 94, 0)]) / 255, atol=1e-6)
    assert_allclose([marker.color.a for marker in lines], [1.0, 0.35])
    for marker, path in zip(lines, forecast.models["SGAN"].samples[3]):
        points = [(point.x, point.y, point.z) for point in marker.points]
        assert_array_equal(np.array(points)[1:, :2], path)
        assert (seconds_of(marker.header.stamp), marker.header.frame_id) == (
            100.5,
            "odom",
        )
        assert (marker.pose.orientation.w, {point[2] for point in points}) == (1, {0})
        assert (marker.type, marker.scale.x) == (4, 0.05)  # A LINE_STRIP.
        assert (marker.lifetime.sec, marker.lifetime.nanosec) == (0, 800_000_000)


def test_a_ros_2_with_another_definition_gets_no_bytes_of_ours(monkeypatch):
    store, notices, sent = typestore(2), [], []
    hashes = {
        "/markers": store.hash_rihs01(MARKERS),
        "/other": "RIHS01_0",
        "/old": "INVALID",
    }
    publisher = SimpleNamespace(publish=sent.append, get_subscription_count=lambda: 1)
    graph = SimpleNamespace(
        create_publisher=lambda form, topic, depth: SimpleNamespace(
            **vars(publisher), topic_name=topic
        ),
        get_name=lambda: "ours",
        get_publishers_info_by_topic=lambda topic: [
            SimpleNamespace(node_name="ours", topic_type_hash=hashes[topic]),
            SimpleNamespace(node_name="another", topic_type_hash=hashes["/markers"]),
        ],
    )
    monkeypatch.setattr(ros2, "message_type", lambda kind: None)
    node = SimpleNamespace(node=graph, _store=store, report=notices.append)
    node._compare = functools.partial(ros2.ForecastNode._compare, node)
    for topic in hashes:
        outlet = ros2.ForecastNode._advertise(node, topic, MARKERS)
        assert outlet.is_heard() == (topic != "/other")
        outlet.publish(lambda: blank(store, MARKERS))
    assert sent == [bytes(store.serialize_cdr(blank(store, MARKERS), MARKERS))] * 2
    assert notices == [
        f"this ROS 2 defines {MARKERS} in another way: nothing is published on /other"
    ]


TRACKED = {
    # github.com/spencer-project/spencer_messages
    "spencer_tracking_msgs/msg/TrackedPerson": "uint64 track_id\nbool is_occluded\n"
    "bool is_matched\nuint64 detection_id\nduration age\ngeometry_msgs/PoseWithCovariance pose\n"
    "geometry_msgs/TwistWithCovariance twist\n",
    "spencer_tracking_msgs/msg/TrackedPersons": "std_msgs/Header header\nTrackedPerson[] tracks\n",
}


def header(store, kind: str) -> dict[str, str]:
    """What a publisher of ROS 1 sends first."""
    text, md5 = store.generate_msgdef(kind, ros_version=1)
    names = {
        "type": kind.replace("/msg/", "/"),
        "md5sum": md5,
        "message_definition": text,
    }
    return {"callerid": "/tracker", **names}


def test_a_definition_is_learned_from_its_publisher():
    store = typestore(1)
    for name, text in TRACKED.items():
        store.register(get_types_from_msg(text, name))
    tracked, kind = TRACKED
    # As published with it.
    assert store.generate_msgdef(tracked)[1] == "28bdd0d6d6551c668e4fde8aecdf1885"
    message, track = blank(store, kind), blank(store, tracked)
    message.header.stamp.sec, message.header.frame_id = 3, "odom"
    track.track_id, track.pose.pose.position.x, track.pose.pose.position.y = 9, 1.0, 2.0
    message.tracks.append(track)
    data, definition = bytes(store.serialize_ros1(message, kind)), header(store, kind)
    decoder = Decoder()
    assert decoder.refuse(definition) is None
    seen = see(*decoder.decode(data, definition))
    assert_array_equal(seen.xyz[:, :2], [[1, 2]])
    assert_array_equal(seen.ids, [9])
    assert (seen.stamp, seen.frame_id) == (3.0, "odom")


def test_what_is_not_understood_is_refused_with_a_reason():
    decoder = Decoder()
    poses = header(decoder.store, "geometry_msgs/msg/PoseArray")
    assert decoder.refuse(poses) is None
    for change, reason in (
        ({"type": "std_msgs/String"}, "none of the types of docs/robot.md; --people"),
        (
            {"type": "people_msgs/People"},
            "not people_msgs/People with md5 18722f4b8db20cc",
        ),
        ({"message_definition": "}{"}, "definition cannot be read"),
        ({"md5sum": "0"}, "whose definition has the md5"),
    ):
        assert reason in str(decoder.refuse({**poses, "md5sum": "1", **change}))


ROS = ROOT / "ros"


def test_topics_of_the_first_model_do_not_name_it():
    topics = [output.topic for output in messages.outputs(["a b", "runs/Ä-1"])]
    base = "/hri/human_poses_prediction"
    ends = ["", "/samples", "/events", "/markers", "/costmap"]
    ends += [f"/costmap/in_{seconds}s" for seconds in (1, 2, 3)]
    assert topics == [base + end for end in ends] + [
        f"{base}_runs___1{end}" for end in ends
    ]


PACKAGES = sorted(path.parent for path in ROS.glob("*/package.xml"))


@pytest.mark.parametrize("package", PACKAGES, ids=lambda path: path.name)
def test_a_package_is_for_both_ros(package):
    root = ElementTree.parse(package / "package.xml").getroot()
    assert root.findtext("name") == package.name
    assert {element.text for element in root.iter("build_type")} == {
        "catkin",
        "ament_cmake",
    }
    cmake = (package / "CMakeLists.txt").read_text()
    assert re.search(rf"project\({package.name}\b", cmake)
    expected = {element.text for element in root.iter("depend")}
    assert expected == {
        *re.findall(r"^  find_package\((\w+_msgs) REQUIRED\)", cmake, re.MULTILINE)
    }


def test_parameters_are_options_and_the_views_are_of_our_topics():
    parameters = yaml.safe_load((ROS / "neurosym_ros/config/forecast.yaml").read_text())
    flat = {name for name, value in parameters.items() if not isinstance(value, dict)}
    assert flat <= Options.__dataclass_fields__.keys()
    assert parameters["stitch"] is Options(model=()).stitch is False
    published = {output.topic for output in messages.outputs(["any model"])}
    for path in (ROS / "neurosym_ros/rviz").iterdir():
        shown = set(re.findall(r"/hri/\S+", path.read_text()))
        assert len(shown) == 2
        assert shown <= published
    compile(
        (ROS / "neurosym_ros/launch/forecast.launch.py").read_text(), "launch", "exec"
    )
