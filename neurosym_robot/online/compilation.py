"""When the programs of a stream are compiled, one for each of a few numbers of people.

At the start; or each when it is needed, for a recording, which waits; or, on a robot, meanwhile in
a thread, first the one that the people present need. Until it is ready, fewer of them are forecast.
"""

import threading
from collections.abc import Callable, Sequence
from typing import Literal

__all__ = ["Programs", "When"]

When = Literal["start", "needed", "meanwhile"]
Compile = Callable[[int], object]


class Programs:
    """Programs of a stream that are ready, and those to come."""

    def __init__(
        self, sizes: Sequence[int], when: When, report: Callable[[str], None], forecast: Compile
    ):
        """Compile at the start, or begin to.

        `sizes` are the numbers of people that have a program each, ascending; `forecast` compiles
        the forecast of such a number; `report` is called with one line for each.
        """
        self.sizes, self._when, self._report, self._forecast = sizes, when, report, forecast
        self._ready: set[int] = set()
        self._tasks: list[tuple[int, Compile]] = []
        self._wanted = sizes[0]
        self._lock = threading.Lock()
        self.waiting = False
        """Whether programs are still to be compiled in the thread."""
        self.add(self._compile)

    def add(self, compile: Compile, sizes: Sequence[int] | None = None) -> None:
        """Call `compile` with all numbers of people, or with `sizes`, unless on need only."""
        tasks = [(size, compile) for size in (self.sizes if sizes is None else sizes)]
        for size, each in tasks if self._when == "start" else ():
            each(size)
        with self._lock:
            self._tasks += tasks if self._when == "meanwhile" else []
            if self._tasks and not self.waiting:
                self.waiting = True
                # Not a daemon: a process that ends while XLA compiles would crash.
                threading.Thread(target=self._work).start()

    def fit(self, people: int) -> int:
        """The size to forecast `people` with: a smaller one while none that fits is ready, or 0."""
        wanted = next((size for size in self.sizes if size >= people), self.sizes[-1])
        if self._when == "needed" and wanted not in self._ready:
            self._compile(wanted)
        with self._lock:
            self._wanted = wanted
            largest = max(self._ready, default=0)
            return min((size for size in self._ready if size >= wanted), default=largest)

    def _compile(self, size: int) -> None:
        n = self.sizes.index(size) + 1
        self._report(f"compiling for up to {size} people ({n} of {len(self.sizes)})")
        self._forecast(size)
        with self._lock:
            self._ready.add(size)

    def _work(self) -> None:
        while threading.main_thread().is_alive():
            with self._lock:
                if not self._tasks:
                    self.waiting = False
                    self._report("everything is compiled")
                    return
                first = self._wanted, self._compile
                task = min(self._tasks, key=lambda each: (each != first, each[1] != first[1]))
                self._tasks.remove(task)
            size, compile = task
            compile(size)
