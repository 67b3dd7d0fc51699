"""The newest events of a stream for any number of readers, none of which holds up the others."""

import collections
import secrets
import threading

__all__ = ["Stream"]

BATCH = 64  # events that a reader takes at once, and so what it may hold that the stream has let go


class Stream:
    """A ring of numbered texts, bounded in bytes; the oldest make room for the newest."""

    def __init__(self, limit: int = 32 * 2**20):
        """Empty; `limit` is in bytes."""
        self._limit, self._size = limit, 0
        self._events: collections.deque[bytes] = collections.deque()
        self._first = 1  # number of the oldest
        self._changed = threading.Condition()
        self.ended = False
        self.session = secrets.token_hex(8)
        """Tells this stream from those of other runs."""

    def append(self, event: bytes) -> None:
        """Add the newest."""
        with self._changed:
            self._events.append(event)
            self._size += len(event)
            while self._size > self._limit and len(self._events) > 1:
                self._size -= len(self._events.popleft())
                self._first += 1
            self._changed.notify_all()

    def end(self) -> None:
        """Nothing more comes."""
        with self._changed:
            self.ended = True
            self._changed.notify_all()

    def after(self, number: int, timeout: float) -> tuple[int, list[bytes]]:
        """Events after that number: the number of the first, and up to `BATCH` of them.

        Waits up to `timeout` seconds for one; those that are gone are skipped.
        """
        with self._changed:
            self._changed.wait_for(
                lambda: self.ended or self._first + len(self._events) > number + 1, timeout
            )
            first = max(number + 1, self._first)
            begin = first - self._first
            count = max(0, min(BATCH, len(self._events) - begin))
            return first, [self._events[begin + n] for n in range(count)]
