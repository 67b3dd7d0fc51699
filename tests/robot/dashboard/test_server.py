"""The server serves its page and its stream, to whom it should, whatever it is sent."""

import contextlib
import http.client
import json
import random
import socket
import threading
import time

import pytest

from neurosym_robot.dashboard import dashboard as server
from neurosym_robot.dashboard.dashboard import BATCH
from neurosym_robot.server import MOST, Ring
from tests.robot.ros.tcpros.conftest import wait


def port_of(dashboard) -> int:
    return int(dashboard.where.rstrip("/").rpartition(":")[2])


def get(dashboard, path="/", method="GET", source="127.0.0.1", **headers):
    """Status, headers and body of the answer to a peer at the address `source`."""
    connection = http.client.HTTPConnection(
        "127.0.0.1", port_of(dashboard), timeout=10, source_address=(source, 0)
    )
    with contextlib.closing(connection):
        connection.request(method, path, headers=headers)
        answer = connection.getresponse()
        return answer.status, dict(answer.getheaders()), answer.read()


def say(dashboard, data: bytes) -> bytes:
    """What comes back for these bytes, until the server closes or a second passes."""
    with socket.create_connection(
        ("127.0.0.1", port_of(dashboard)), timeout=1
    ) as client:
        heard = b""
        with contextlib.suppress(OSError):
            client.sendall(data)
            client.shutdown(socket.SHUT_WR)
            part = client.recv(4096)
            while part:
                heard += part
                part = client.recv(4096)
        return heard


def read_events(dashboard, last: str = "") -> list[dict[str, str]]:
    """The events of a stream that has ended."""
    headers = {"Last-Event-ID": last} if last else {}
    status, _, body = get(dashboard, "/events", **headers)
    assert status == 200
    blocks = body.decode().strip().split("\n\n")
    events = []
    for block in blocks:
        events.append(dict(line.split(":", 1) for line in block.split("\n")))
    return events


def test_nothing_but_the_page_and_the_stream(dashboard):
    status, headers, page = get(dashboard)
    assert status == 200
    assert headers["Content-Type"].startswith("text/html")
    assert page.startswith(b"<!doctype html>")
    assert b"://" not in page  # It asks nobody for anything.
    for path in (
        "/page.js",
        "/favicon.ico",
        "/../etc/passwd",
        "/events/",
        "/%2e%2e/",
        "*",
    ):
        assert get(dashboard, path)[0] == 404
    for method in ("POST", "DELETE", "HEAD"):
        assert get(dashboard, method=method)[0] == 501


def test_what_is_refused_leaves_no_thread_behind(dashboard):
    get(dashboard, method="POST")
    before = threading.active_count()
    for _ in range(60):
        get(dashboard, method="POST")
    wait(lambda: threading.active_count() <= before, 2.0)


def test_names_that_are_not_ours_are_refused(dashboard):
    names = {
        "localhost:80": 200,
        "127.0.0.1": 200,
        "[::1]:9": 200,
        "192.168.0.7:1": 200,
    }
    names |= {
        f"{socket.gethostname().upper()}.local": 200,
        "evil.example": 403,
        "": 403,
    }
    names |= {
        "127.0.0.1.evil.example:8765": 403,
        "localhost.evil.example": 403,
        "[": 403,
    }
    for name, status in names.items():
        assert get(dashboard, Host=name)[0] == status, name
    assert b" 403 " in say(dashboard, b"GET /events HTTP/1.0\r\n\r\n")


def test_no_other_address_of_this_computer_is_served(dashboard):
    with pytest.raises(OSError, match=r"refused|assign|reach"):
        socket.create_connection(("127.0.0.2", port_of(dashboard)), 5)


def test_the_stream_is_what_was_shown(dashboard, moments, stream):
    events = list(stream(5))
    for event in events:
        dashboard.show(*event)
    dashboard.end(events[-1][1]["score"])
    rows = [row for row in read_events(dashboard) if row.get("event") != " beat"]
    assert [message.get("event") for message in rows[:2]] == [" introduction", " anew"]
    assert rows[-1]["event"] == " end"
    lines = [json.loads(message["data"]) for message in rows[2:-1]]
    assert [line["t"] for line in lines[:-1]] == [n / 10 for n in range(50)]
    assert lines[-1]["score"]["forecasts"] == events[-1][1]["score"]["forecasts"]
    # Who comes again is told the rest; who comes from another run, everything.
    rest = read_events(dashboard, rows[41]["id"].strip())
    assert rest.pop(-2)["event"] == " beat"  # after what was kept, before the end
    assert [message["data"] for message in rest] == [
        message["data"] for message in [rows[0], *rows[42:]]
    ]
    assert len(read_events(dashboard, "0123-40")) == len(rows) + 1
    assert len(read_events(dashboard, f"{rows[9]['id'].strip()}x")) == len(rows) + 1


@pytest.mark.slow
def test_slow_and_vanished_readers_delay_nobody(
    dashboard, moments, stream, monkeypatch
):
    monkeypatch.setattr(server, "PATIENCE", 0.5)
    monkeypatch.setattr(server._Handler, "timeout", 0.5)
    monkeypatch.setattr(server, "HEARTBEAT", 0.1)
    before = threading.active_count()
    readers = []
    for _ in range(8):
        reader = socket.socket()
        reader.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        reader.connect(("127.0.0.1", port_of(dashboard)))
        reader.sendall(b"GET /events HTTP/1.1\r\nHost: localhost\r\n\r\n")
        readers.append(reader)
    for reader in readers[:4]:
        reader.close()
    events = list(stream(8))
    began = time.monotonic()
    for n in range(10):
        for event, now in events:
            frame = event.frame._replace(stamp=event.frame.stamp + 8 * n)
            dashboard.show(event._replace(frame=frame), now)
    assert time.monotonic() - began < 60
    assert get(dashboard)[0] == 200
    wait(lambda: threading.active_count() <= before)
    for reader in readers[4:]:
        reader.close()


def test_what_is_no_http_is_survived(dashboard, capfd):
    rng = random.Random(0)
    good = b"GET /events HTTP/1.1\r\nHost: localhost\r\nLast-Event-ID: a-1\r\n\r\n"
    odd = [
        b"",
        b"GET\r\n\r\n",
        b"GET / HTTP/9.9\r\n\r\n",
        b"\x16\x03\x01\x02\x00\x01" + bytes(64),
    ]
    odd += [b"GET /" + b"a" * 70_000 + b" HTTP/1.1\r\n\r\n"]
    odd += [
        b"GET / HTTP/1.1\r\n" + row + b"\r\n"
        for row in (b"X: y\r\n" * 200, b"Host: [[[::]\r\n")
    ]
    for _ in range(60):
        data = bytearray(good)
        for _ in range(rng.randrange(1, 12)):
            data[rng.randrange(len(data))] = rng.randrange(256)
        odd.append(bytes(data))
    dashboard._server.stream.end()  # So that a stream that is asked for comes to its end.
    for data in odd:
        heard = say(dashboard, data)
        assert (
            not heard
            or heard[:5] == b"HTTP/"
            or b"doctype" in heard
            or heard[:1].isdigit()
        )
    assert get(dashboard)[0] == 200
    output = capfd.readouterr()
    assert "Traceback" not in output.out + output.err


def test_half_open_connections_are_bounded_by_address_and_in_time(dashboard):
    before, address = {*threading.enumerate()}, ("127.0.0.1", port_of(dashboard))
    with contextlib.ExitStack() as flood:
        for _ in range(3 * MOST):
            flood.enter_context(socket.create_connection(address))
        began = time.monotonic()
        assert get(dashboard, source="127.0.0.2")[0] == 200
        assert time.monotonic() - began < server.ASKING / 2
        # A thread that answers, and one that ends waiting; the answered peer's may be
        # about to end.
        assert len({*threading.enumerate()} - before) <= 2 * (server.TABS + 1)

        def answered() -> bool:
            with contextlib.suppress(OSError, http.client.HTTPException):
                return get(dashboard)[0] == 200
            return False

        wait(answered, 2 * server.ASKING)


def test_what_is_remembered_is_bounded():
    stream = Ring(limit=1000)
    for n in range(1000):
        stream.append(b"%09d" % n)
    first, events = stream.after(0, 0, BATCH)
    assert events[0] == b"%09d" % (first - 1)
    assert len(events) == BATCH
    rest = stream.after(first + BATCH - 1, 0, 1000)[1]
    assert len(events) + len(rest) == 1000 // 9
    assert rest[-1] == b"000000999"
    assert stream.after(1000, 0) == (1001, [])
    stream.append(b"x" * 5000)  # Larger than all that may be: alone.
    assert stream.after(0, 0) == (1001, [b"x" * 5000])
