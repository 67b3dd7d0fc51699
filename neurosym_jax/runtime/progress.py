"""How far a long piece of work is: a line on the standard error for each step."""

import sys
import time

__all__ = ["Progress"]


class Progress:
    """Progress of `total` steps."""

    def __init__(self, total: int):
        """Start the clock."""
        self._total, self._done, self._start = total, 0, time.perf_counter()

    def step(self, what: str) -> None:
        """Count one step, called `what`."""
        self._done += 1
        seconds = time.perf_counter() - self._start
        print(f"[{self._done}/{self._total}] {what} ({seconds:.1f} s)", file=sys.stderr)
