"""One process at a time trains in a folder."""

import contextlib
import time
from collections.abc import Iterator
from pathlib import Path

from neurosym_jax.errors import InputError
from neurosym_jax.runtime.files import refuse_unwritable

__all__ = ["sole_writer", "wait_for_others"]


@contextlib.contextmanager
def sole_writer(folder: Path) -> Iterator[None]:
    """Hold `folder`, which is made where it is missing; whatever ends the process lets go of it.

    Raises:
        InputError: when another process holds it, or nothing can be written there.
    """
    refuse_unwritable(folder / ".lock")
    try:
        import fcntl
    except ImportError:  # Not on Windows, where nothing guards the folder.
        yield
        return
    folder.mkdir(parents=True, exist_ok=True)
    with (folder / ".lock").open("w") as file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise InputError(f"{folder}: another process is training there") from None
        yield


def wait_for_others(folder: Path, *, seconds: float) -> None:
    """Wait until no other process trains in `folder`, so long at most."""
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        with contextlib.suppress(InputError), sole_writer(folder):
            return
        time.sleep(0.1)
