"""One file over HTTP, whole or not at all: what is at the target has the pinned SHA-256.

What has come so far is kept beside the target as `NAME.part`, from where the next try, or the next
call, goes on, if the server can (`Range`); else it begins anew.
"""

import hashlib
import os
import threading
import time
from collections.abc import Callable
from concurrent.futures import Future
from concurrent.futures import TimeoutError as FutureTimeout
from http.client import HTTPException
from pathlib import Path
from typing import TypeVar
from urllib.error import HTTPError, URLError
from urllib.request import Request, urlopen

from neurosym_jax.errors import InputError, printable

__all__ = ["sha256_of", "transfer"]

T = TypeVar("T")

PAUSE = 1.0
"""Seconds before the second try; each later pause is twice as long."""

LEAST = 2000.0
"""Bytes a second; a slower connection is given up, after `timeout` seconds at the earliest."""

_CHUNK = 1 << 16


class TooSlow(OSError):
    """A connection that brings less than `LEAST`."""


def sha256_of(path: Path) -> str:
    """Hexadecimal SHA-256 of a file's content."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def transfer(
    url: str,
    target: Path,
    size: int,
    sha256: str,
    *,
    timeout: float = 20.0,
    tries: int = 4,
    progress: Callable[[int], object] = lambda count: None,
) -> None:
    """Bring `url` to `target`, whose folder is made where it is missing.

    Args:
        url: http, https or file.
        target: of the file.
        size: bytes that the file must have.
        sha256: that it must have, hexadecimal.
        timeout: seconds of silence after which a connection is given up; all that is less than
            `LEAST` counts as silence.
        tries: connections, the first included.
        progress: called with the bytes that are here.

    Raises:
        InputError: naming address and reason, where the file did not come or is not the one that
            is pinned; there is nothing at `target` then.
    """
    part = target.with_name(f"{target.name}.part")
    target.parent.mkdir(parents=True, exist_ok=True)
    reason = ""
    for attempt in range(tries):
        if attempt:
            time.sleep(PAUSE * 2 ** (attempt - 1))
        try:
            over = threading.Event()
            try:
                _in_time(
                    timeout + size / LEAST,
                    lambda over=over: _receive(url, part, size, timeout, progress, over),
                )
            finally:
                over.set()
        except TooSlow as error:
            reason = str(error)
            break
        except HTTPError as error:
            reason = f"the server answers {error.code} {error.reason}"
            if error.code == 416:  # What is here is no beginning of what is there.
                part.unlink(missing_ok=True)
            elif error.code < 500 and error.code not in (408, 429):
                break
        except URLError as error:
            reason = str(error.reason)
        except (OSError, HTTPException, ValueError) as error:
            reason = str(error) or type(error).__name__
        else:
            if sha256_of(part) == sha256:
                os.replace(part, target)
                return
            part.unlink()
            reason = "its SHA-256 is not the published one, so it was thrown away"
    raise InputError(f"{url}: {printable(reason)}")


def _in_time(seconds: float, action: Callable[[], T]) -> T:
    """What `action()` gives within so many seconds.

    A time-out of sockets begins anew with every byte, also while a name is looked up or headers
    come; so somebody else has the clock.

    Raises:
        TooSlow: when they are over; the action goes on in a thread that nobody waits for.
    """
    done: Future[T] = Future()

    def act() -> None:
        try:
            done.set_result(action())
        except BaseException as error:
            done.set_exception(error)

    threading.Thread(target=act, daemon=True).start()
    try:
        return done.result(seconds)
    except FutureTimeout:
        if done.done():
            raise
        raise TooSlow(f"it was not there after {seconds:.0f} s") from None


def _receive(
    url: str,
    part: Path,
    size: int,
    timeout: float,
    progress: Callable[[int], object],
    over: threading.Event,
) -> None:
    """Append to `part` what it lacks of `size` bytes.

    Raises:
        OSError: where the connection breaks or what comes has another length.
    """
    here = part.stat().st_size if part.exists() else 0
    if here == size:
        return
    here = here if here < size else 0
    request = Request(url, headers={"Range": f"bytes={here}-"} if here else {})
    with _in_time(2 * timeout, lambda: urlopen(request, timeout=timeout)) as response:
        if here and not response.headers.get("Content-Range", "").startswith(f"bytes {here}-"):
            here = 0
        with part.open("ab" if here else "wb") as file:
            start, before = time.monotonic(), here
            # Not `read`, which would lose what came before the silence.
            while (chunk := response.read1(_CHUNK)) and not over.is_set():
                here += len(chunk)
                spent = time.monotonic() - start
                if spent > timeout and here - before < LEAST * spent and here < size:
                    file.write(chunk)
                    raise TooSlow(f"less than {LEAST:g} bytes a second came")
                if here > size:
                    file.truncate(0)
                    raise OSError(f"more than the {size} bytes that are published")
                file.write(chunk)
                progress(here)
    if here < size:
        raise OSError(f"the connection ended after {here} of {size} bytes")
