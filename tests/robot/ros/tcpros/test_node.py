"""Nodes find each other, again after a restart, and go on whatever strangers send."""

import contextlib
import functools
import http.client
import random
import socket
import struct
import threading
import time
from typing import Any

import pytest

from neurosym_robot.commands import _live_options
from neurosym_robot.ros.tcpros import Node, Topic
from neurosym_robot.ros.tcpros.topics import MOST, Publisher
from neurosym_robot.ros.tcpros.wire import (
    CallError,
    Refused,
    SlaveServer,
    call,
    encode_header,
    read_block,
    read_header,
)
from neurosym_robot.server import ConnectionServer
from tests.robot.ros.tcpros.conftest import CHATTER, wait


def say(pair, data: bytes) -> None:
    """What the talker says is heard."""
    pair.publisher.publish(data)
    wait(lambda: pair.heard[-1:] == [data])


def test_connections_that_break_are_made_again_and_survive_their_master(pair, master):
    for connection in list(pair.talker._data.connections):
        connection.shutdown(socket.SHUT_RDWR)
    wait(lambda: any("lost" in line for line in pair.listener.said))
    wait(lambda: pair.publisher.subscribers and pair.subscriber.publishers)
    # A restarted master has forgotten everything, and learns of us again.
    for table in (master.nodes, master.publishers, master.subscribers):
        table.clear()
    pair.subscriber.update([])
    say(pair, b"still there")
    wait(lambda: master.publishers[CHATTER.name] == [pair.talker.uri])
    wait(lambda: master.subscribers[CHATTER.name] == [pair.listener.uri])
    assert any("registers again" in line for line in pair.talker.said)
    assert list(pair.subscriber.publishers) == [pair.talker.uri]


def test_a_message_right_after_the_handshake_is_heard():
    """A thread that publishes may run as soon as the subscriber has the header."""
    publisher, (ours, theirs) = (
        Publisher(CHATTER, "/talker", print),
        socket.socketpair(),
    )
    publish = functools.cache(lambda: publisher.publish(b"first"))

    class Connection(socket.socket):
        def sendall(self, *data):
            super().sendall(*data)
            publish()

    connection = Connection(fileno=ours.detach())
    header = {"callerid": "/listener", "md5sum": "*"}
    serving = threading.Thread(target=publisher.serve, args=(connection, header))
    with connection, theirs:
        serving.start()
        theirs.settimeout(30)
        assert read_header(theirs)["type"] == CHATTER.type
        assert read_block(theirs) == b"first"
        theirs.shutdown(socket.SHUT_RDWR)
        serving.join(30)
    assert publisher.subscribers == []


def test_another_definition_is_refused_in_one_line(graph):
    other = Topic(CHATTER.name, "other_msgs/String", "0" * 32)
    heard, listener, talker = [], graph("listener"), graph("talker")
    listener.subscribe(CHATTER, lambda data, uri: heard.append(data))
    talker.advertise(other)
    wait(lambda: listener.said)
    time.sleep(0.5)
    (line,) = listener.said
    assert line.endswith(
        f"refused: it publishes other_msgs/String with md5 {'0' * 32}, "
        "not std_msgs/String with md5 992ce8a1687cec8c8bd883ec73ca41d1"
    )
    assert heard == []
    # The other way round, a subscriber that insists is told why.
    with knock(talker, md5sum=CHATTER.md5) as connection:
        assert CHATTER.md5 in read_header(connection)["error"]
    assert "refused the subscriber somebody" in talker.said[0]


def knock(talker: Node, **fields: str) -> socket.socket:
    """A connection to a publisher, whose handshake is begun."""
    _, *address = call(talker.uri, "requestTopic", "/me", CHATTER.name, [["TCPROS"]])
    connection = socket.create_connection(tuple(address))
    connection.sendall(encode_header({"topic": CHATTER.name, "md5sum": "*", **fields}))
    return connection


def test_a_subscriber_that_does_not_read_delays_nobody_and_is_dropped(
    pair, monkeypatch
):
    monkeypatch.setattr("neurosym_robot.ros.tcpros.topics.SLOW", 0.5)
    with knock(pair.talker, callerid="/slow"):
        wait(lambda: set(pair.publisher.subscribers) == {"/slow", "/listener"})
        took, sent = 0.0, [bytes([n]) * (1 << 18) for n in range(100)]
        for data in sent:
            start = time.perf_counter()
            pair.publisher.publish(data)
            took = max(took, time.perf_counter() - start)
            wait(lambda data=data: pair.heard[-1:] == [data])
        assert took < 0.4
        wait(lambda: pair.publisher.subscribers == ["/listener"])
    assert pair.talker.said == [
        "/chatter: dropped the subscriber /slow, which does not read"
    ]
    for n in range(100):
        pair.publisher.publish(b"%d" % n)
    wait(lambda: len(pair.heard) == 200)
    assert pair.heard == [*sent, *(b"%d" % n for n in range(100))]


def test_closing_leaves_no_thread_and_no_registration_and_who_comes_again_is_found(
    master,
):
    before, heard = set(threading.enumerate()), []
    for n in range(2):
        nodes = [Node(f"node{n}", master.uri, lambda line: None) for n in range(2)]
        for node in nodes:
            publisher = node.advertise(CHATTER)
            publisher.publish(b"nobody hears it")
            node.subscribe(CHATTER, lambda data, uri: heard.append(data))
        wait(lambda publisher=publisher: len(publisher.subscribers) == 2)
        publisher.publish(b"%d" % n)
        wait(lambda n=n: heard == [b"0"] * 2 + [b"1"] * 2 * n)
        for node in nodes:
            node.close()
        wait(lambda: set(threading.enumerate()) <= before)
        assert not master.publishers[CHATTER.name]
        assert not master.subscribers[CHATTER.name]


def test_the_graph_can_ask(pair):
    node, other = pair.talker, pair.listener
    row = [0, "/listener", "o", "TCPROS", "/chatter", True]
    assert call(node.uri, "getBusInfo", "/me") == [row]
    for uri, method in ((node.uri, "getPublications"), (other.uri, "getSubscriptions")):
        assert call(uri, method, "/me") == [["/chatter", "std_msgs/String"]]
    with pytest.raises(Refused, match="does not publish"):
        call(other.uri, "requestTopic", "/me", "/chatter", [["TCPROS"]])
    call(node.uri, "shutdown", "/master", "new node of the same name")
    assert node.stopped.is_set()


def test_who_ends_a_node_does_not_steer_its_terminal(master, capsys):
    node = Node("talker", master.uri, _live_options.say)
    call(node.uri, "shutdown", "/who\x9b2J", "a\nb")
    node.close()
    assert "asked to end by /who\\x9b2J: a\\nb\n" in capsys.readouterr().err


def test_a_block_beyond_the_limit_is_not_waited_for():
    ours, theirs = socket.socketpair()
    with ours, theirs:
        theirs.settimeout(5)
        ours.sendall(struct.pack("<I", 10_001))
        with pytest.raises(ConnectionError, match="10001 bytes was announced"):
            read_block(theirs, 10_000)


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


def test_nonsense_at_the_port_of_a_publisher(pair):
    address = pair.talker._data.server_address[1]
    for seed in range(150):
        stranger = socket.create_connection(("127.0.0.1", address))
        with stranger, contextlib.suppress(OSError):
            stranger.sendall(hostile_blocks(seed))
    wait(lambda: len(pair.talker._data.connections) == 1)
    say(pair, b"still there")
    assert pair.publisher.subscribers == ["/listener"]


def test_a_publisher_that_talks_nonsense(pair):
    """Its XML-RPC is sound or not, its TCPROS is not; the good one beside it is heard."""
    seed, subscriber = iter(range(10**9)), pair.subscriber

    def serve(connection: socket.socket) -> None:
        read_block(connection, 10_000)
        n = next(seed)
        with contextlib.suppress(OSError):
            connection.sendall(
                encode_header({"md5sum": CHATTER.md5}) * (n % 2) + hostile_blocks(n)
            )

    data = ConnectionServer("127.0.0.1", serve)
    answers: list[Any] = [["TCPROS", "127.0.0.1", data.server_address[1]]] * 8
    answers += [0, "", [], ["TCPROS"], ["TCPROS", 7, "x"], ["UDPROS", "a", 1]]
    answers += [
        ["TCPROS", host, 1]
        for host in ("a" * 100, "..", "\x00", "no such host", {"a": 1})
    ]
    slaves = [
        SlaveServer("127.0.0.1", {"requestTopic": lambda *_, answer=answer: answer})
        for answer in answers
    ]
    uris = [f"http://127.0.0.1:{slave.server_address[1]}/" for slave in slaves]
    subscriber.update([*subscriber.publishers, *uris])
    wait(lambda: next(seed) > 40)
    pair.publisher.publish(b"whole")
    wait(lambda: b"whole" in pair.heard)
    assert max(map(len, pair.listener.said)) < 500
    subscriber.close()
    for channel in (data, *slaves):
        channel.close()


CALL = b"<methodCall><methodName>getPid</methodName>"
BODIES = [
    b"",
    b"\x00\xff\xfe",
    b"<methodCall/>",
    CALL + b"</methodCall>",
    CALL + b"<params>" + b"<param><value>" * 5000,
    b"<params><param><value><array><data>" + b"<value><array><data>" * 20_000,
    b"<params><param><value><int>" + b"9" * 6000 + b"</int></value></param></params>",
    b"<params><param><value><base64>x</base64></value></param></params>",
    b'<?xml version="1.0"?><!DOCTYPE a [<!ENTITY a "aaaaaaaaaa">'
    + b"".join(
        b'<!ENTITY %c "%s">' % (c, b"&%c;" % (c - 1) * 10) for c in range(98, 108)
    )
    + b"]><methodCall><methodName>&k;</methodName></methodCall>",
]
ARGUMENTS = [
    (),
    (1,),
    ("/x",),
    ("/x", "/chatter"),
    ("/x", "/chatter", 7),
    ("/x", 1, [1, [2]]),
]
ARGUMENTS += [
    ("/x", "/chatter", ["no uri", 3]),
    ({"a": 1}, [], {}),
    ("/x", "/chatter", [[]]),
]


def post(uri: str, body: bytes, headers: dict[str, str] | None = None) -> None:
    connection = http.client.HTTPConnection(uri.split("/")[2], timeout=5)
    with (
        contextlib.closing(connection),
        contextlib.suppress(OSError, http.client.HTTPException),
    ):
        connection.request("POST", "/RPC2", body, headers or {})
        connection.getresponse().read()


def test_nonsense_at_the_port_for_calls(graph):
    node, rng = graph("node"), random.Random(0)
    subscriber = node.subscribe(CHATTER, lambda data, uri: None)
    for body in BODIES:
        cut = rng.randrange(len(body) + 1)
        post(node.uri, body)
        post(node.uri, body[:cut] + rng.randbytes(3) + body[cut:])
        post(node.uri, body, {"Content-Encoding": "gzip"})
    for length in ("-1", "x", str(10**9), "1" * 5000):
        post(node.uri, b"", {"Content-Length": length})
    for method in {*node._methods(), "nothing", "\x00"} - {"shutdown"}:
        for arguments in ARGUMENTS:
            with contextlib.suppress(CallError):
                call(node.uri, method, *arguments)
    many = [f"http://127.0.0.1:{port}/" for port in range(1, 60_000, 6)]
    assert call(node.uri, "publisherUpdate", "/master", CHATTER.name, many) == 0
    assert len(subscriber._links) <= MOST
    call(node.uri, "publisherUpdate", "/master", CHATTER.name, [])
    assert call(node.uri, "getPid", "/me") > 0
    wait(
        lambda: (
            not any(
                thread.name.startswith("/chatter") for thread in threading.enumerate()
            )
        )
    )
    assert not node.stopped.is_set()


def test_nobody_answers():
    with socket.create_server(("127.0.0.1", 0)) as silent:
        start = time.monotonic()
        with pytest.raises(CallError, match="timed out"):
            call(
                f"http://127.0.0.1:{silent.getsockname()[1]}",
                "getPid",
                "/me",
                timeout=0.2,
            )
        assert time.monotonic() - start < 2
    for uri in (
        "http://no-such-host.invalid:1",
        "nonsense",
        "http://",
        "http://a:99999999/",
    ):
        with pytest.raises(CallError):
            call(uri, "getPid", "/me")


def test_who_shakes_hands_byte_by_byte_does_not_stay(graph, monkeypatch):
    for name in ("HANDSHAKE", "TIMEOUT"):
        monkeypatch.setattr(f"neurosym_robot.ros.tcpros.wire.{name}", 0.5)
    node = graph("patient")
    for port in (node._port, node._slave.server_address[1]):
        began = time.monotonic()
        with socket.create_connection(("127.0.0.1", port), 10) as slow:
            with contextlib.suppress(OSError):
                slow.sendall(
                    b"\xff\x00\x00\x00"
                )  # The length of a header that takes 25 s.
                while time.monotonic() - began < 10:
                    slow.sendall(b"\x01")
                    time.sleep(0.1)
            assert 0.4 < time.monotonic() - began < 5
