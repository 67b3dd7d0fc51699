"""What a training tells while it runs: the bar, and what is compiled for how long."""

import contextlib
import sys
import threading
import time
from collections.abc import Iterator, Mapping
from typing import Any

from tqdm import tqdm

__all__ = ["Progress"]

LONG = 30.0
"""Seconds after which a compilation is told to go on."""


class Progress:
    """The progress of a run of `steps` steps on the standard error, from the first second on."""

    def __init__(self, steps: int, programs: tuple[str, ...], *, quiet: bool = False):
        """Compile `programs`, in words, each when it is first needed."""
        self._quiet, self._programs, self._since = quiet, [*programs], time.monotonic()
        self._count = len(programs)
        # tqdm's None shows the bar in a terminal only.
        self._bar = tqdm(total=steps, unit="step", disable=True if quiet else None)

    def __enter__(self) -> "Progress":
        """Show the bar."""
        return self

    def __exit__(self, *error: object) -> None:
        """Leave the bar as it is."""
        self._bar.close()

    @contextlib.contextmanager
    def compiling(self, program: str) -> Iterator[None]:
        """Say that a program is compiled, the first time that it is run within this context."""
        if program not in self._programs:
            yield
            return
        self._programs.remove(program)
        label = (
            f"{program} (program {self._count - len(self._programs)} of {self._count})"
        )
        self._say(f"compiling {label}: usually 5 to 60 s, once on this machine")
        notice = (
            f"still compiling {label}: XLA needs long for it here; nothing is wrong"
        )
        timer = threading.Timer(LONG, self._say, (notice,))
        timer.daemon = True
        timer.start()
        try:
            yield
        finally:
            timer.cancel()
        self._say(f"{program} compiled and run")

    def go_to(self, step: int, metrics: Mapping[str, Any]) -> None:
        """Show a number of steps, and losses and errors."""
        numbers = {
            name: f"{value:.3f}"
            for name, value in metrics.items()
            if name.endswith(("loss", "ade"))
        }
        self._bar.set_postfix(numbers, refresh=False)
        self._bar.update(step - self._bar.n)

    def _say(self, text: str) -> None:
        if not self._quiet:
            seconds = time.monotonic() - self._since
            self._bar.write(f"[{seconds:.0f} s] {text}", file=sys.stderr)
