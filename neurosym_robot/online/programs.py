"""When the programs of a stream are compiled, one for each of a few numbers of people.

All at the start; or each when it is needed, which a recording waits for; or, on a robot, the
smallest at the start and the others meanwhile, in a thread, where those come first that the people
who are there ask for. Until then fewer of them can be forecast.
"""

import threading
from collections.abc import Callable, Sequence
from typing import Literal

__all__ = ["Programs", "When"]

When = Literal["start", "needed", "meanwhile"]  # when a program is compiled


class Programs:
    """What is ready, and what is to come."""

    def __init__(self, sizes: Sequence[int], when: When, report: Callable[[str], None]):
        """Nothing is compiled yet.

        Args:
            sizes: numbers of people that have a program each, ascending.
            when: they are compiled.
            report: is told, in one line each, of what is compiled.
        """
        self.sizes, self._when, self._report = tuple(sizes), when, report
        self._ready: set[int] = set()
        self._forecast: Callable[[int], object] = lambda size: None
        self._waiting: list[tuple[int, Callable[[int], object]]] = []
        self._wanted = 0
        self._lock = threading.Lock()
        self._thread: threading.Thread | None = None

    def begin(self, forecast: Callable[[int], object]) -> None:
        """Compile what forecasts, as far as is to be done before anything else.

        Args:
            forecast: compiles what forecasts up to so many people.
        """
        self._forecast = forecast
        at_once = {"start": self.sizes, "needed": (), "meanwhile": self.sizes[:1]}[self._when]
        for size in at_once:
            self._compile(size)
        self._later([(size, self._compile) for size in self.sizes[len(at_once) :]])

    def add(self, compile: Callable[[int], object], sizes: Sequence[int] | None = None) -> None:
        """Compile what else is wanted of a forecast; where it is compiled when needed, nothing.

        Args:
            compile: for up to so many people.
            sizes: those that have one each; all if None.
        """
        todo = [(size, compile) for size in (self.sizes if sizes is None else sizes)]
        if self._when == "start":
            for size, each in todo:
                each(size)
        self._later(todo)

    @property
    def waiting(self) -> bool:
        """Whether something is still to be compiled."""
        return self._thread is not None

    def fit(self, people: int) -> int:
        """The size to forecast so many people with; a smaller one while none is ready."""
        wanted = next((size for size in self.sizes if size >= people), self.sizes[-1])
        if self._when == "needed" and wanted not in self._ready:
            self._compile(wanted)
        with self._lock:
            self._wanted = wanted
            return min((size for size in self._ready if size >= wanted), default=max(self._ready))

    def _compile(self, size: int) -> None:
        n = self.sizes.index(size) + 1
        self._report(f"compiling for up to {size} people ({n} of {len(self.sizes)})")
        self._forecast(size)
        with self._lock:
            self._ready.add(size)

    def _later(self, todo: Sequence[tuple[int, Callable[[int], object]]]) -> None:
        if self._when != "meanwhile":
            return
        with self._lock:
            self._waiting += todo
            if self._waiting and self._thread is None:
                # No daemon: a process that ends while XLA compiles would crash.
                self._thread = threading.Thread(target=self._work)
                self._thread.start()

    def _work(self) -> None:
        while threading.main_thread().is_alive():
            with self._lock:
                if not self._waiting:
                    self._thread = None
                    break
                # What those who are there ask for; then the smallest, in the order of adding.
                todo = min(self._waiting, key=lambda each: (each[0] != self._wanted, each[0]))
                self._waiting.remove(todo)
            size, compile = todo
            compile(size)
        else:
            return
        self._report("everything is compiled")
