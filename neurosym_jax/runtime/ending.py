"""One way to end: SIGINT, SIGTERM and SIGHUP interrupt a command, and soon after end its process.

Python runs a signal's handler between two of its own instructions: not while XLA
compiles, nor while it waits for a thread at exit; and a library may swallow what the
handler raises. So a thread waits for the signal too, and ends the process where the
command has not.
"""

import contextlib
import os
import signal
import threading
import time
from collections.abc import Callable, Iterator
from types import FrameType

__all__ = ["PATIENCE", "interruptible", "when_ended"]

PATIENCE = 1.5
"""Seconds from the signal to the end."""
NAMES = "SIGINT", "SIGTERM", "SIGHUP"
SIGNALS = [getattr(signal, name) for name in NAMES if hasattr(signal, name)]

SAID = b"interrupted\n"

_cleanups: set[Callable[[], object]] = set()


@contextlib.contextmanager
def when_ended(cleanup: Callable[[], object]) -> Iterator[None]:
    """Call `cleanup` if the context is left by an error, or the process is ended within it.

    It may run in another thread, so it must wait for nothing.
    """
    _cleanups.add(cleanup)
    try:
        yield
    except BaseException:
        cleanup()
        raise
    finally:
        _cleanups.discard(cleanup)


@contextlib.contextmanager
def interruptible() -> Iterator[list[int]]:
    """Interrupt what runs within by signals; yields a list, to which each that came is added.

    The first says so and raises `KeyboardInterrupt`, the second ends the process at
    once. A signal that is ignored stays so (nohup), and one for which the command has
    its own handler is left to that.
    """
    if threading.current_thread() is not threading.main_thread():
        yield []
        return
    came: list[int] = []

    def interrupt(number: int, frame: FrameType | None) -> None:
        if not came:
            os.write(2, SAID)
        came.append(number)
        signal.signal(number, signal.SIG_DFL)
        raise KeyboardInterrupt

    reader, writer = os.pipe()
    os.set_blocking(writer, False)
    earlier = signal.set_wakeup_fd(writer, warn_on_full_buffer=False)
    ignored = [
        number for number in SIGNALS if signal.getsignal(number) is signal.SIG_IGN
    ]
    handlers = {n: signal.signal(n, interrupt) for n in SIGNALS if n not in ignored}
    watch = threading.Thread(target=_watch, args=(reader, interrupt, came), daemon=True)
    watch.start()
    try:
        yield came
    finally:
        if not came:
            signal.set_wakeup_fd(earlier)
            for number, handler in handlers.items():
                signal.signal(number, handler)
            os.close(writer)
            watch.join()
            os.close(reader)


def _watch(reader: int, interrupt: Callable[..., None], came: list[int]) -> None:
    """End the process `PATIENCE` after a signal that `interrupt` handles, unless it has ended."""
    while content := os.read(reader, 1):
        number = content[0]
        if number not in SIGNALS or signal.getsignal(number) not in (
            interrupt,
            signal.SIG_DFL,
        ):
            continue
        time.sleep(PATIENCE)
        if not came:  # Python had no time to run the handler.
            os.write(2, SAID)
        for cleanup in list(_cleanups):
            with contextlib.suppress(Exception):
                cleanup()
        os._exit(128 + number)
