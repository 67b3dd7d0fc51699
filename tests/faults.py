"""Faults of the disk: of all operations that change it, the n-th fails.

Counted are files and folders made, what is written to them, syncs and moves, as far as they go
through Python. A write that fails leaves half of what was to be written.
"""

import builtins
import contextlib
import errno
import io
import os
from collections.abc import Iterator
from typing import Any

__all__ = ["Faults", "failing"]


class Faults:
    """Counts operations; the one of number `at` fails, once."""

    def __init__(self, at: int | None):
        self.at, self.count = at, 0

    def due(self) -> bool:
        """Whether the operation that is about to be done is the one that fails."""
        self.count += 1
        return self.count == self.at

    def strike(self) -> None:
        """Fail where it is due."""
        if self.due():
            raise full()


def full() -> OSError:
    """What a full disk says."""
    return OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


@contextlib.contextmanager
def failing(at: int | None = None) -> Iterator[Faults]:
    """Within, operation number `at` fails, from 1; None counts them only."""
    faults = Faults(at)
    places = [(os, name) for name in ("fsync", "mkdir", "open", "rename", "replace")]
    kept = [(module, name, getattr(module, name)) for module, name in places]

    def striking(operation: Any) -> Any:
        def strike_first(*arguments: Any, **options: Any) -> Any:
            changes = operation is not os_open or arguments[1] & (os.O_CREAT | os.O_WRONLY)
            if changes:
                faults.strike()
            return operation(*arguments, **options)

        return strike_first

    os_open, plain_open = os.open, io.open

    def opening(file: Any, mode: str = "r", *arguments: Any, **options: Any) -> Any:
        changes = set(mode) & set("wax+") and not str(file).startswith("/dev/")
        if changes:
            faults.strike()
        opened: Any = plain_open(file, mode, *arguments, **options)
        if changes:
            write = opened.write

            def write_or_fail(data: Any) -> int:
                if faults.due():
                    write(data[: len(data) // 2])
                    opened.flush()
                    raise full()
                return write(data)

            opened.write = write_or_fail
        return opened

    for module, name, operation in kept:
        setattr(module, name, striking(operation))
    io.open = builtins.open = opening
    try:
        yield faults
    finally:
        io.open = builtins.open = plain_open
        for module, name, operation in kept:
            setattr(module, name, operation)
