"""What shows a stream frame by frame: a page, a file, a bag, Foxglove."""

import collections
import itertools
import threading
from collections.abc import Mapping, Sequence
from typing import Any

from neurosym_robot.online.predictor import Forecast
from neurosym_robot.online.replay import ReplayEvent

SHOW = 0.02  # seconds at least between two moments of a live page


class View:
    """Shows a stream frame by frame, until it is closed."""

    title: str
    where: str
    """What it is, such as "the page is at", and its address or file."""

    def show(self, event: ReplayEvent, now: Mapping[str, Any]) -> None:
        """Show a frame; `now` is `Status.now()`."""

    def end(self, score: Mapping[str, Any], scored: Sequence[Forecast] = ()) -> None:
        """Show the final `Analytics.summary()`, and the last forecasts that were scored."""

    def close(self) -> None:
        """Stop showing."""


class Newest(View):
    """Shows what is newest in other views, in a thread of its own: they hold nothing up."""

    def __init__(self, views: Sequence[View]):
        """Begin the thread."""
        self._views, self._ended = views, threading.Event()
        self._shown: collections.deque[Any] = collections.deque(maxlen=1)
        self._thread = threading.Thread(target=self._work, daemon=True)
        self._thread.start()

    def show(self, event: ReplayEvent, now: Mapping[str, Any]) -> None:
        """Show the frame soon, unless a newer one comes before."""
        self._shown.append((event, now))

    def end(self, score: Mapping[str, Any], scored: Sequence[Forecast] = ()) -> None:
        """Show the newest frame, and end the views."""
        self.close()
        for view in self._views:
            view.end(score, scored)

    def close(self) -> None:
        """End the thread; the views stay open."""
        self._ended.set()
        self._thread.join()

    def _work(self) -> None:
        ended = False
        while not ended:
            ended = self._ended.wait(SHOW)
            newest = [self._shown.pop()] if self._shown else []
            for view, arguments in itertools.product(self._views, newest):
                view.show(*arguments)
