"""Whatever strangers send, a node goes on, stays small, and keeps what it says short."""

import contextlib
import http.client
import random
import socket
import struct
import threading
import time

import pytest

from neurosym_robot.ros.tcpros import Topic
from neurosym_robot.ros.tcpros.topics import MOST
from neurosym_robot.ros.tcpros.wire import (
    encode_header,
    read_block,
)
from neurosym_robot.ros.tcpros.xmlrpc import CallError, SlaveServer, call
from neurosym_robot.server import ConnectionServer

CHATTER = Topic("/chatter", "std_msgs/String", "992ce8a1687cec8c8bd883ec73ca41d1", "string data")


def hostile_blocks(seed: int) -> bytes:
    """Something like the beginning of a connection."""
    rng = random.Random(seed)
    good = encode_header({"topic": CHATTER.name, "md5sum": "*", "callerid": "/x"})
    flipped = bytearray(good)
    flipped[rng.randrange(len(good))] ^= 1 << rng.randrange(8)
    return rng.choice(
        [
            rng.randbytes(rng.randrange(200)),
            good[: rng.randrange(len(good))],
            bytes(flipped),
            struct.pack("<I", rng.getrandbits(32)) + rng.randbytes(20),
            good + rng.randbytes(5000),
            encode_header({rng.choice(["topic", "md5sum", "", "a" * 999]): "x" * 999}),
            b"GET / HTTP/1.1\r\n\r\n",
        ]
    )


def test_nonsense_at_the_port_of_a_publisher(graph, wait):
    heard, talker = [], graph("talker")
    publisher = talker.advertise(CHATTER)
    subscriber = graph("listener").subscribe(CHATTER, lambda data, uri: heard.append(data))
    wait(lambda: subscriber.publishers)
    address = talker._data.server_address[1]
    for seed in range(150):
        stranger = socket.create_connection(("127.0.0.1", address))
        with stranger, contextlib.suppress(OSError):
            stranger.sendall(hostile_blocks(seed))
    wait(lambda: len(talker._data.connections) == 1)
    publisher.publish(b"still there")
    wait(lambda: heard == [b"still there"])
    assert publisher.subscribers == ["/listener"]


def test_a_publisher_that_talks_nonsense(graph, wait):
    """Its XML-RPC is sound, its TCPROS is not; the good one beside it is heard."""
    seed = iter(range(10**9))

    def serve(connection: socket.socket) -> None:
        read_block(connection, 10_000)
        n = next(seed)
        if n % 2:
            connection.sendall(encode_header({"md5sum": CHATTER.md5}))
        with contextlib.suppress(OSError):
            connection.sendall(hostile_blocks(n))

    heard, listener = [], graph("listener")
    data = ConnectionServer("127.0.0.1", serve)
    answer = ["TCPROS", "127.0.0.1", data.server_address[1]]
    slaves = [SlaveServer("127.0.0.1", {"requestTopic": lambda *_: answer}) for _ in range(8)]
    slaves += [SlaveServer("127.0.0.1", {"requestTopic": lambda *_, bad=bad: bad}) for bad in BAD]
    subscriber = listener.subscribe(CHATTER, lambda data, uri: heard.append(data))
    good = graph("talker").advertise(CHATTER)
    wait(lambda: subscriber.publishers)
    uris = [f"http://127.0.0.1:{slave.server_address[1]}/" for slave in slaves]
    subscriber.update([*subscriber.publishers, *uris])
    wait(lambda: next(seed) > 40)
    good.publish(b"whole")
    wait(lambda: b"whole" in heard)
    assert max(map(len, listener.said)) < 500
    subscriber.close()
    for each in (data, *slaves):
        each.close()


BAD = [0, "", [], ["TCPROS"], ["TCPROS", 7, "x"], ["TCPROS", "", -1], ["UDPROS", "a", 1], [1] * 9]
BAD += [["TCPROS", host, 1] for host in ("a" * 100, "..", "\x00", "no such host", {"a": 1})]

BODIES = [
    b"",
    b"\x00\xff\xfe",
    b"<",
    b"<methodCall/>",
    b"<methodCall><methodName>getPid</methodName></methodCall>",
    b"<methodCall><methodName>getPid</methodName><params>" + b"<param><value>" * 5000,
    b"<params><param><value><array><data>" + b"<value><array><data>" * 20_000,
    b"<params><param><value><int>" + b"9" * 6000 + b"</int></value></param></params>",
    b"<params><param><value><base64>x</base64></value></param></params>",
    b'<?xml version="1.0"?><!DOCTYPE a [<!ENTITY a "aaaaaaaaaa">'
    + b"".join(b'<!ENTITY %c "%s">' % (c, b"&%c;" % (c - 1) * 10) for c in range(98, 108))
    + b"]><methodCall><methodName>&k;</methodName></methodCall>",
]

ARGUMENTS = [(), (1,), ("/x",), ("/x", "/chatter"), ("/x", "/chatter", 7), ("/x", 1, [1, [2]])]
ARGUMENTS += [("/x", "/chatter", ["no uri", 3]), ({"a": 1}, [], {}), ("/x", "/chatter", [[]])]


def post(uri: str, body: bytes, headers: dict[str, str] | None = None) -> None:
    connection = http.client.HTTPConnection(uri.split("/")[2], timeout=5)
    with contextlib.closing(connection), contextlib.suppress(OSError, http.client.HTTPException):
        connection.request("POST", "/RPC2", body, headers or {})
        connection.getresponse().read()


def test_nonsense_at_the_port_for_calls(graph, wait):
    node = graph("node")
    subscriber = node.subscribe(CHATTER, lambda data, uri: None)
    rng = random.Random(0)
    for body in BODIES:
        post(node.uri, body)
        post(node.uri, body, {"Content-Encoding": "gzip"})
        for length in ("-1", "x", str(10**9), "1" * 5000):
            post(node.uri, b"", {"Content-Length": length})
        cut = rng.randrange(len(body) + 1)
        post(node.uri, body[:cut] + rng.randbytes(3) + body[cut:])
    for method in (*node._methods(), "nothing", "\x00"):
        for arguments in ARGUMENTS:
            if method != "shutdown":
                with contextlib.suppress(CallError):
                    call(node.uri, method, *arguments)
    many = [f"http://127.0.0.1:{port}/" for port in range(1, 60_000, 6)]
    assert call(node.uri, "publisherUpdate", "/master", CHATTER.name, many) == 0
    assert len(subscriber._links) <= MOST
    call(node.uri, "publisherUpdate", "/master", CHATTER.name, [])
    assert call(node.uri, "getPid", "/me") > 0
    wait(lambda: not any(thread.name.startswith("/chatter") for thread in threading.enumerate()))
    assert not node.stopped.is_set()


def test_nobody_answers():
    with socket.create_server(("127.0.0.1", 0)) as silent:
        start = time.monotonic()
        with pytest.raises(CallError, match="timed out"):
            call(f"http://127.0.0.1:{silent.getsockname()[1]}", "getPid", "/me", timeout=0.2)
        assert time.monotonic() - start < 2
    for uri in ("http://no-such-host.invalid:1", "nonsense", "http://", "http://a:99999999/"):
        with pytest.raises(CallError):
            call(uri, "getPid", "/me")


def test_who_shakes_hands_byte_by_byte_does_not_stay(graph, monkeypatch):
    monkeypatch.setattr("neurosym_robot.ros.tcpros.node.HANDSHAKE", 0.5)
    monkeypatch.setattr("neurosym_robot.ros.tcpros.xmlrpc.TIMEOUT", 0.5)
    node = graph("patient")
    for port in (node._port, node._slave.server_address[1]):
        began = time.monotonic()
        with socket.create_connection(("127.0.0.1", port), 10) as slow:
            with contextlib.suppress(OSError):
                while time.monotonic() - began < 10:
                    slow.sendall(b"\x01")
                    time.sleep(0.1)
            assert 0.4 < time.monotonic() - began < 5
