"""The compiled programs of a predictor, one for each of a few numbers of people."""

import gc
import threading
from collections.abc import Callable, Sequence
from typing import Any, Literal

When = Literal["start", "needed", "meanwhile"]
"""When programs are compiled: at the start; or each when it is needed, for a recording, which
waits; or, on a robot, meanwhile in a thread, first the one that the people present need. Until it
is ready, fewer of them are forecast."""

Use = Callable[[Any], object]


class Programs:
    """Programs of a stream, one for each of a few numbers of people: those ready, and to come."""

    def __init__(
        self,
        sizes: Sequence[int],
        when: When,
        report: Callable[[str], None],
        forecast: Callable[[int], Any],
    ):
        """Compile at the start, or begin to.

        `sizes` are the numbers of people that have a program each, ascending; without
        any, every number is forecast as it is;
        `forecast` forecasts such a number; `report` is called with one line before it
        is compiled.
        """
        self.sizes, self._when, self._report, self._forecast = (
            sizes,
            when,
            report,
            forecast,
        )
        self._begun: set[int] = set()
        self._ready: set[int] = set()
        self._tasks: list[tuple[int, Use]] = []
        self._wanted = min(sizes, default=0)
        self._lock = threading.Lock()
        self.waiting = False
        """Whether programs are still to be compiled in the thread."""
        self.add(lambda forecast: None)

    def add(self, use: Use) -> None:
        """Compile what computes something of a forecast by doing so, or begin to."""
        with self._lock:
            self._tasks += [(size, use) for size in self.sizes]
            begin = self._when == "meanwhile" and bool(self._tasks) and not self.waiting
            self.waiting |= begin
        if begin:
            # Not a daemon: a process that ends while XLA compiles would crash.
            threading.Thread(target=self._work).start()
        for size in self.sizes if self._when == "start" else ():
            self._compile_now(size)

    def fit(self, people: int) -> int:
        """The size to forecast `people` with: a smaller one while none that fits is ready, or 0."""
        if not self.sizes:
            return people
        size_wanted = next(
            (size for size in self.sizes if size >= people), self.sizes[-1]
        )
        if self._when == "needed" and self._compile_now(size_wanted):
            _settle()
        with self._lock:
            self._wanted = size_wanted
            largest = max(self._ready, default=0)
            return min(
                (size for size in self._ready if size >= size_wanted), default=largest
            )

    def _compile_now(self, size: int) -> bool:
        """Compile what is not compiled yet for so many people; whether there was anything."""
        tasks = [task for task in self._tasks if task[0] == size]
        for task in tasks:
            self._tasks.remove(task)
            self._compile(*task)
        return bool(tasks)

    def _compile(self, size: int, use: Use) -> None:
        if size not in self._begun:
            self._begun.add(size)
            n = self.sizes.index(size) + 1
            self._report(
                f"compiling for up to {size} people ({n} of {len(self.sizes)})"
            )
        use(self._forecast(size))
        with self._lock:
            # All that is computed of a forecast must be compiled before the first one:
            # otherwise a stream would wait for it.
            if all(task[0] != size for task in self._tasks):
                self._ready.add(size)

    def _work(self) -> None:
        while threading.main_thread().is_alive():
            with self._lock:
                if not self._tasks:
                    self.waiting = False
                    _settle()
                    self._report("everything is compiled")
                    return
                task = min(self._tasks, key=lambda pair: pair[0] != self._wanted)
                self._tasks.remove(task)
            self._compile(*task)


def _settle() -> None:
    """Leave what is there after compiling out of later collections: 0.2 s each, amid a stream."""
    gc.unfreeze()  # Of earlier predictors; what they left is collected.
    gc.collect()
    gc.freeze()
