"""What Foxglove is sent is what was seen and forecast: by its websocket, and in an MCAP."""

import base64
import contextlib
import json
import socket
import struct

import numpy as np
import pytest
from numpy.testing import assert_allclose

from neurosym_jax.errors import InputError
from neurosym_robot.dashboard.foxglove_view import FoxgloveView
from tests.robot.dashboard.conftest import predictor

pytest.importorskip("foxglove", reason="foxglove-sdk is not installed")


@pytest.fixture(scope="module")
def schema():
    """What decodes a SceneUpdate, from the definition that is sent along."""
    pool = pytest.importorskip("google.protobuf.descriptor_pool", reason="no protobuf")
    from google.protobuf import descriptor_pb2, message_factory

    def decode(definition: bytes, data: bytes):
        schemas = pool.DescriptorPool()
        for file in descriptor_pb2.FileDescriptorSet.FromString(definition).file:
            schemas.Add(file)
        kind = schemas.FindMessageTypeByName("foxglove.SceneUpdate")
        return message_factory.GetMessageClass(kind).FromString(data)

    return decode


def check(scene, event) -> None:
    """The scene is the frame's people, the samples of each and the most probable path."""
    frame, forecast = event.frame, event.forecast
    entities = {entity.id: entity for entity in scene.entities}
    assert len(entities) == len(frame.ids) * (1 + len(forecast.models))
    for n, id in enumerate(frame.ids.tolist()):
        body = entities[f"person {id}"]
        at = body.spheres[0].pose.position
        assert_allclose([at.x, at.y], frame.xy[n])
        assert (body.texts[0].text, body.frame_id) == (str(id), "odom")
        stamp = body.timestamp.seconds + 1e-9 * body.timestamp.nanos
        assert stamp == pytest.approx(frame.stamp, abs=1e-6)
        for name, result in forecast.models.items():
            region, *lines = entities[f"{name} {id}"].lines
            ring = [(point.x, point.y) for point in region.points]
            assert_allclose(np.mean(ring, axis=0), result.regions.mean[n, -1])
            ways = []
            for line in lines:
                ways.append([(point.x, point.y) for point in line.points])
            expected = [*result.samples[:, n], result.samples[result.central, n]]
            assert_allclose(np.array(ways)[:, 1:], expected)
            assert_allclose(
                np.array(ways)[:, 0], [forecast.observed[n, -1]] * len(ways)
            )
            thickness, opacity = zip(
                *((line.thickness, line.color.a) for line in lines)
            )
            assert (thickness.index(max(thickness)), opacity.index(max(opacity))) == (
                5,
                5,
            )


def test_an_mcap_holds_scene_numbers_and_events(stream, schema, tmp_path):
    reader = pytest.importorskip("mcap.reader", reason="mcap is not installed")
    path, events = tmp_path / "people.mcap", list(stream(4))
    view = FoxgloveView(predictor(), path, frame_id=lambda: "odom", at_least=0.05)
    for event in events:
        view.show(*event)
    view.close()
    with path.open("rb") as file:
        rows = list(reader.make_reader(file).iter_messages())
    entities = {"/forecasts": [], "/stream": [], "/events": []}
    for row in rows:
        entities.setdefault(row[1].topic, []).append(row)
    assert len(entities["/forecasts"]) == len(entities["/stream"]) == len(events)
    assert [row[2].log_time for row in entities["/forecasts"]] == [
        round(1e9 * event.frame.stamp) for event, _ in events
    ]
    definition, _, message = entities["/forecasts"][-1]
    check(schema(definition.data, message.data), events[-1][0])
    numbers = json.loads(entities["/stream"][-1][2].data)
    assert numbers["age"] == events[-1][1]["age"]
    assert numbers["missing"] == {"7": "short", "9": "<script>"}
    assert entities["/events"]
    with pytest.raises(InputError, match="cannot be used for Foxglove"):
        FoxgloveView(predictor(), path)


def test_a_client_is_told_by_websocket(stream, schema):
    client = pytest.importorskip(
        "websockets.sync.client", reason="websockets is not installed"
    )
    view = FoxgloveView(predictor(), 0, frame_id=lambda: "odom")
    *_, last = stream(4)
    with client.connect(view.where, subprotocols=["foxglove.sdk.v1"]) as peer:
        channels, heard = {}, ""
        while len(channels) < 3:
            message = json.loads(peer.recv(timeout=10))
            channels |= {
                channel["topic"]: channel for channel in message.get("channels", ())
            }
        scene = channels["/forecasts"]
        subscription = {
            "op": "subscribe",
            "subscriptions": [{"id": 7, "channelId": scene["id"]}],
        }
        peer.send(json.dumps(subscription))
        for _ in range(100):
            view.show(*last)
            with contextlib.suppress(TimeoutError):
                heard = peer.recv(timeout=0.1)
            if isinstance(heard, bytes):
                break
        stamp = round(1e9 * last[0].frame.stamp)
        assert struct.unpack_from("<BIQ", heard) == (1, 7, stamp)
        check(schema(base64.b64decode(scene["schema"]), heard[13:]), last[0])
    # Another address of this computer, as one of its network would be.
    with pytest.raises(OSError, match=r"refused|assign|reach"):
        socket.create_connection(("127.0.0.2", int(view.where.rpartition(":")[2])), 5)
    with pytest.raises(InputError, match="cannot be used for Foxglove"):
        FoxgloveView(predictor(), int(view.where.rpartition(":")[2]))
    view.close()
