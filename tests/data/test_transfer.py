"""A real server on this machine that does all that servers do."""

import contextlib
import hashlib
import threading
import time
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

import pytest

from neurosym_jax.data import transfer as module
from neurosym_jax.data.transfer import transfer
from neurosym_jax.errors import InputError

BODY = bytes(range(256)) * 1024
SHA = hashlib.sha256(BODY).hexdigest()


class Server(ThreadingHTTPServer):
    """Answers the requests one after the other as `script` says, the last of it for ever."""

    script: tuple = ()
    ranges: list

    def __init__(self):
        super().__init__(("127.0.0.1", 0), Handler)
        self.ranges, self.over = [], threading.Event()

    @property
    def url(self):
        return f"http://127.0.0.1:{self.server_port}/file"


class Handler(BaseHTTPRequestHandler):
    def log_message(self, format, *args):
        pass

    def do_GET(self):
        asked = self.headers.get("Range")
        self.server.ranges.append(asked)
        script = self.server.script
        step = script[min(len(self.server.ranges), len(script)) - 1]
        first = int(asked.removeprefix("bytes=").removesuffix("-")) if asked else 0
        if isinstance(step, int):
            self.send_error(step)
            return
        resumes = first and "norange" not in step
        body = BODY[first:] if resumes else BODY
        if "corrupt" in step:
            body = bytes(len(body))
        if "long" in step:
            body += b"more"
        if "headers" in step:
            with contextlib.suppress(OSError):
                while not self.server.over.wait(0.05):
                    self.wfile.write(b"H")
            return
        self.send_response(206 if resumes else 200)
        if resumes:
            self.send_header("Content-Range", f"bytes {first}-{len(BODY) - 1}/{len(BODY)}")
        if "chunked" not in step:
            self.send_header("Content-Length", str(len(body)))
        self.end_headers()
        if "drip" in step:
            with contextlib.suppress(OSError):
                while not self.server.over.wait(0.05):
                    self.wfile.write(b"x")
            return
        if "cut" in step or "stall" in step:
            body = body[:100_000]
        self.wfile.write(body)
        if "stall" in step:
            self.wfile.flush()
            self.server.over.wait(20)


@pytest.fixture
def server(monkeypatch):
    monkeypatch.setattr(module, "PAUSE", 0.001)
    with Server() as server:
        threading.Thread(target=server.serve_forever, args=(0.01,), daemon=True).start()
        yield server
        server.over.set()
        server.shutdown()


def bring(server, target, **options):
    seen = []
    transfer(server.url, target, len(BODY), SHA, timeout=0.5, progress=seen.append, **options)
    assert target.read_bytes() == BODY
    assert list(target.parent.iterdir()) == [target]
    return seen


@pytest.mark.parametrize(
    ("script", "ranges"),
    [
        (("whole",), [None]),
        (("cut", "whole"), [None, "bytes=100000-"]),
        (("cut chunked", "whole"), [None, "bytes=100000-"]),
        (("stall", "whole"), [None, "bytes=100000-"]),
        (("cut", "cut", "whole"), [None, "bytes=100000-", "bytes=200000-"]),
        (("cut", "norange"), [None, "bytes=100000-"]),
        (("cut", "norange cut", "whole"), [None, "bytes=100000-", "bytes=100000-"]),
        (("cut", 416, "whole"), [None, "bytes=100000-", None]),
        (("corrupt", "whole"), [None, None]),
        (("cut", "corrupt", "whole"), [None, "bytes=100000-", None]),
        (("long", "whole"), [None, None]),
        ((503, 429, "whole"), [None, None, None]),
    ],
)
def test_comes_whole_in_the_end(server, tmp_path, script, ranges):
    server.script = script
    seen = bring(server, tmp_path / "new" / "file")
    assert server.ranges == ranges
    assert seen[-1] == len(BODY)


@pytest.mark.parametrize(
    ("script", "reason", "requests", "kept"),
    [
        ((404,), "the server answers 404 Not Found", 1, None),
        ((403,), "the server answers 403", 1, None),
        ((500,), "the server answers 500", 3, None),
        (("corrupt",), "its SHA-256 is not the published one", 3, None),
        (("long",), f"more than the {len(BODY)} bytes that are published", 3, 0),
        (("stall norange",), "timed out", 3, 100_000),
        (("cut norange chunked",), f"ended after 100000 of {len(BODY)} bytes", 3, 100_000),
    ],
)
def test_does_not_come(server, tmp_path, script, reason, requests, kept):
    server.script = script
    target = tmp_path / "file"
    with pytest.raises(InputError, match=reason) as caught:
        bring(server, target, tries=3)
    assert str(caught.value).startswith(f"{server.url}: ")
    assert len(server.ranges) == requests
    assert not target.exists()
    part = tmp_path / "file.part"
    assert (part.stat().st_size if part.exists() else None) == kept


def test_the_next_call_goes_on(server, tmp_path):
    server.script = ("cut", "whole")
    with pytest.raises(InputError, match="100000 of"):
        bring(server, tmp_path / "file", tries=1)
    bring(server, tmp_path / "file", tries=1)
    assert server.ranges == [None, "bytes=100000-"]


def test_what_is_here_in_part_but_wrong(server, tmp_path):
    """What a killed process left is not trusted."""
    for wrong in (bytes(100), bytes(len(BODY)), bytes(len(BODY) + 1)):
        server.script = ("whole",)
        (tmp_path / "file.part").write_bytes(wrong)
        bring(server, tmp_path / "file")
        (tmp_path / "file").unlink()


def test_nobody_answers(tmp_path, monkeypatch):
    monkeypatch.setattr(module, "PAUSE", 0.001)
    with Server() as server:
        url = server.url
    with pytest.raises(InputError, match="refused"):
        transfer(url, tmp_path / "file", 1, SHA)
    with pytest.raises(InputError, match="unknown url type"):
        transfer("nowhere", tmp_path / "file", 1, SHA)


@pytest.mark.parametrize(
    ("step", "reason"),
    [("drip", "less than 2000 bytes a second came"), ("headers", "not there after 1 s")],
)
def test_a_server_that_drips_is_given_up_at_once(server, tmp_path, step, reason):
    server.script = (step,)
    start = time.monotonic()
    with pytest.raises(InputError, match=reason):
        bring(server, tmp_path / "file")
    assert time.monotonic() - start < 5
    assert len(server.ranges) == 1
