"""How far a long piece of work is: a bar in a terminal or a notebook, else a line for each step."""

import sys
import time
from contextlib import AbstractContextManager

from tqdm.auto import tqdm

__all__ = ["Progress", "without_bars"]


def without_bars() -> AbstractContextManager[None]:
    """A context without bars, in which something can be printed."""
    return tqdm.external_write_mode()


class Progress:
    """Progress of `total` steps on the standard error. Use as a context manager."""

    def __init__(self, total: int, what: str, unit: str):
        """Name the work, and one step of it, for people."""
        self._total, self._done, self._start = total, 0, time.perf_counter()
        bar = sys.stderr.isatty() or "ipykernel" in sys.modules
        self._lines = not bar
        self._bar = tqdm(total=total, desc=what, unit=unit, disable=not bar, leave=False)

    def __enter__(self) -> "Progress":
        """Return self."""
        return self

    def __exit__(self, *_: object) -> None:
        """Remove the bar."""
        self._bar.close()

    def step(self, what: str) -> None:
        """Count one step, called `what`."""
        self._done += 1
        self._bar.set_postfix_str(what, refresh=False)
        self._bar.update()
        if self._lines:
            seconds = time.perf_counter() - self._start
            print(f"[{self._done}/{self._total}] {what} ({seconds:.1f} s)", file=sys.stderr)
