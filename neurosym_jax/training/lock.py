"""One process at a time trains in a folder."""

import contextlib
from collections.abc import Iterator
from pathlib import Path

from neurosym_jax.errors import InputError
from neurosym_jax.runtime.files import refuse_unwritable

__all__ = ["sole_writer"]


@contextlib.contextmanager
def sole_writer(folder: Path) -> Iterator[None]:
    """Lock `folder`, which is created if needed; the lock ends with the process.

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
