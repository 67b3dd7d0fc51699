"""How far a long piece of work is: a bar in a terminal or a notebook, else a line for each step."""

import sys
import time
from contextlib import AbstractContextManager

from tqdm.auto import tqdm

__all__ = ["Progress", "without_bars"]


def without_bars() -> AbstractContextManager[None]:
    """A context in which bars are away, so that something can be printed."""
    return tqdm.external_write_mode()


class Progress:
    """Tells on the standard error of `total` steps, as a context."""

    def __init__(self, total: int, what: str, unit: str):
        """Nothing is done yet.

        Args:
            total: steps.
            what: is done, for people.
            unit: one step, for people.
        """
        self._total, self._done, self._start = total, 0, time.perf_counter()
        bar = sys.stderr.isatty() or "ipykernel" in sys.modules
        self._lines = not bar
        self._bar = tqdm(total=total, desc=what, unit=unit, disable=not bar, leave=False)

    def __enter__(self) -> "Progress":
        """As it is."""
        return self

    def __exit__(self, *_: object) -> None:
        """Take the bar away."""
        self._bar.close()

    def step(self, what: str) -> None:
        """One step is done: `what`, for people."""
        self._done += 1
        self._bar.set_postfix_str(what, refresh=False)
        self._bar.update()
        if self._lines:
            seconds = time.perf_counter() - self._start
            print(f"[{self._done}/{self._total}] {what} ({seconds:.1f} s)", file=sys.stderr)
