"""Nodes find each other through the master, and again after any of them was restarted."""

import socket
import threading
import time

import pytest

from neurosym_jax.errors import InputError
from neurosym_robot.ros.tcpros import Node, Topic
from neurosym_robot.ros.tcpros.wire import encode_header, read_header
from neurosym_robot.ros.tcpros.xmlrpc import Refused, call

CHATTER = Topic("/chatter", "std_msgs/String", "992ce8a1687cec8c8bd883ec73ca41d1", "string data")


def test_messages_arrive_in_order_and_whole(graph, wait):
    heard = []
    graph("listener").subscribe(CHATTER, lambda data, uri: heard.append(data))
    publisher = graph("talker").advertise(CHATTER, queue_size=100)
    wait(lambda: publisher.subscribers == ["/listener"])
    sent = [bytes([n]) * n * 1000 for n in range(100)]
    for data in sent:
        publisher.publish(data)
    wait(lambda: len(heard) == len(sent))
    assert heard == sent


def test_a_publisher_that_was_restarted_is_found_again(graph, wait):
    heard = []
    listener = graph("listener")
    subscriber = listener.subscribe(CHATTER, lambda data, uri: heard.append(data))
    for n in range(3):
        talker = graph(f"talker{n}")
        publisher = talker.advertise(CHATTER)
        wait(lambda publisher=publisher: publisher.subscribers)
        publisher.publish(b"%d" % n)
        wait(lambda n=n: len(heard) == n + 1)
        talker.close()
        wait(lambda: not subscriber.publishers)
    assert heard == [b"0", b"1", b"2"]


def test_a_connection_that_breaks_is_made_again(graph, wait):
    subscriber = graph("listener").subscribe(CHATTER, lambda data, uri: None)
    talker = graph("talker")
    publisher = talker.advertise(CHATTER)
    wait(lambda: publisher.subscribers)
    for connection in list(talker._data.connections):
        connection.shutdown(socket.SHUT_RDWR)
    wait(lambda: any("lost" in line for line in subscriber.report.__self__))
    wait(lambda: publisher.subscribers and subscriber.publishers)


def test_a_master_that_was_restarted_learns_of_us_again_and_connections_stay(graph, master, wait):
    heard = []
    listener, talker = graph("listener"), graph("talker")
    subscriber = listener.subscribe(CHATTER, lambda data, uri: heard.append(data))
    publisher = talker.advertise(CHATTER)
    wait(lambda: publisher.subscribers and subscriber.publishers)
    master.forget()
    subscriber.update([])
    publisher.publish(b"still there")
    wait(lambda: heard == [b"still there"])
    wait(lambda: master.publishers[CHATTER.name] == [talker.uri])
    wait(lambda: master.subscribers[CHATTER.name] == [listener.uri])
    assert any("registers again" in line for line in talker.said)
    assert list(subscriber.publishers) == [talker.uri]


def test_a_master_that_is_late_is_waited_for(master, wait):
    said = []
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        nowhere = f"http://127.0.0.1:{free.getsockname()[1]}"
    node = Node("early", nowhere, said.append)
    node.advertise(CHATTER)
    wait(lambda: said)
    assert said[0].startswith("waiting for the master")
    node.master = master.uri
    wait(lambda: master.publishers[CHATTER.name] == [node.uri])
    node.close()
    assert master.publishers[CHATTER.name] == []
    assert len(said) == 2


def test_another_definition_is_refused_in_one_line(graph, wait):
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
    protocol = call(talker.uri, "requestTopic", "/me", CHATTER.name, [["TCPROS"]])
    with socket.create_connection(tuple(protocol[1:])) as connection:
        connection.sendall(encode_header({"topic": CHATTER.name, "md5sum": CHATTER.md5}))
        assert CHATTER.md5 in read_header(connection)["error"]
    assert "refused the subscriber somebody" in talker.said[0]


def test_a_subscriber_that_does_not_read_delays_nobody_and_is_dropped(graph, wait, monkeypatch):
    monkeypatch.setattr("neurosym_robot.ros.tcpros.topics.SLOW", 0.5)
    heard, talker = [], graph("talker")
    publisher = talker.advertise(CHATTER)
    graph("listener").subscribe(CHATTER, lambda data, uri: heard.append(data))
    _, host, port = call(talker.uri, "requestTopic", "/slow", CHATTER.name, [["TCPROS"]])
    with socket.create_connection((host, port)) as slow:
        slow.sendall(encode_header({"topic": CHATTER.name, "md5sum": "*", "callerid": "/slow"}))
        wait(lambda: set(publisher.subscribers) == {"/slow", "/listener"})
        took = 0.0
        for n in range(100):
            start = time.perf_counter()
            publisher.publish(bytes(1 << 18))
            took = max(took, time.perf_counter() - start)
            wait(lambda n=n: len(heard) == n + 1)
        assert took < 0.4
        wait(lambda: publisher.subscribers == ["/listener"])
    assert talker.said == ["/chatter: dropped the subscriber /slow, which does not read"]


def test_the_graph_can_ask(graph, master, wait):
    node, other = graph("node"), graph("other")
    node.advertise(CHATTER)
    subscriber = other.subscribe(CHATTER, lambda data, uri: None)
    wait(lambda: subscriber.publishers)
    assert call(node.uri, "getPublications", "/me") == [["/chatter", "std_msgs/String"]]
    assert call(other.uri, "getSubscriptions", "/me") == [["/chatter", "std_msgs/String"]]
    wait(lambda: call(node.uri, "getBusInfo", "/me"))
    (row,) = call(node.uri, "getBusInfo", "/me")
    assert row == [0, "/other", "o", "TCPROS", "/chatter", True]
    with pytest.raises(Refused, match="does not publish"):
        call(other.uri, "requestTopic", "/me", "/chatter", [["TCPROS"]])
    call(node.uri, "shutdown", "/master", "new node of the same name")
    assert node.stopped.is_set()


def test_closing_leaves_no_thread_and_no_registration(master, wait):
    before = set(threading.enumerate())
    nodes = [Node(f"node{n}", master.uri, lambda line: None) for n in range(2)]
    for node in nodes:
        publisher = node.advertise(CHATTER)
        node.subscribe(CHATTER, lambda data, uri: None)
    wait(lambda: len(publisher.subscribers) == 2)
    for node in nodes:
        node.close()
    wait(lambda: set(threading.enumerate()) <= before)
    assert not master.publishers[CHATTER.name]
    assert not master.subscribers[CHATTER.name]


def test_names_and_uris_are_checked():
    for name in ("", "a b", "/a//b", "1a", "a\n"):
        with pytest.raises(InputError, match="not a ROS name"):
            Node(name, "http://localhost:1")
    for uri in ("localhost:11311", "https://localhost:11311", "http://localhost", "http://a:b"):
        with pytest.raises(InputError, match="master's URI"):
            Node("node", uri)
