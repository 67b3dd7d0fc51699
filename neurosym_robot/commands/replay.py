"""Forecast a recording as if it were live."""

import contextlib
import dataclasses
import functools
import math
import time
import warnings
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar, Literal

from neurosym_jax.commands._options import Positional, Reading, refuse_given
from neurosym_jax.data.tables import AS_IT_SAYS
from neurosym_jax.errors import InputError, InputWarning
from neurosym_robot import (
    Analytics,
    Predictor,
    ReplayEvent,
    ReplayFile,
    Status,
    View,
    read_frames,
    replay,
)
from neurosym_robot.commands._live_options import LiveOptions, say
from neurosym_robot.dashboard.view import Newest
from neurosym_robot.input.source import REACH, PeopleSource
from neurosym_robot.ros.definitions import is_bag
from neurosym_robot.ros.forecasting_node import ForecastBag

if TYPE_CHECKING:
    from neurosym_jax.models.place.place import Place


@dataclasses.dataclass(frozen=True, kw_only=True)
class Options(LiveOptions):
    """Forecast a recording frame by frame, and score the forecasts."""

    FIRST: ClassVar[str] = "recording fixed_frame stitch model dashboard rate out html"
    NEEDS = LiveOptions.NEEDS | {
        "map": ("dashboard", "html"),
        "at_least": ("out", "html", "dashboard", "foxglove"),
    }
    recording: Positional[tuple[Path, ...]]
    """A bag (ROS 1 `.bag`; folder, `.db3` or `.mcap` of ROS 2), its parts, or a file of tracks."""
    read: Reading = AS_IT_SAYS
    """How the recording is read."""
    rate: float | Literal["max"] | None = None
    """Speed: 1 is real time (default with --dashboard), max does not wait (default otherwise)."""
    out: Path | None = None
    """Bag of forecasts and observed futures to write: `.bag`, `.db3` or `.mcap`; nothing is
    overwritten."""
    html: Path | None = None
    """HTML file to write: the page of --dashboard with its data inside; nothing is overwritten."""

    def __post_init__(self):
        """Refuse options without effect, of which a file of tracks has more."""
        super().__post_init__()
        if not self.recording:
            raise InputError("a recording to replay is missing")
        if not all(map(is_bag, self.recording)):
            # Bags and Foxglove tell the name of the coordinates' frame.
            named = [self.out, self.foxglove, self.place] != [None, None, None]
            unused = {
                "fixed_frame": self.fixed_frame and not named,
                "reach": self.reach != REACH,
            }
            unused |= {
                "robot_frame": self.robot_frame,
                "people": self.people,
                "only": self.only,
            }
            refuse_given("on a file of tracks", **unused)

    @functools.cached_property
    def watched(self) -> "Place | None":
        """As of nodes; InputError where a file of tracks may be of another frame."""
        place = super().watched
        if place is None or not place.frame or self.fixed_frame:
            return place
        if not all(map(is_bag, self.recording)):
            raise InputError(
                f"{self.place}: is of the frame {place.frame!r}: if the recording is, "
                f"too, --fixed-frame {place.frame} says so"
            )
        return place

    def files(
        self, predictor: Predictor, title: str, source: PeopleSource
    ) -> Iterator[View]:
        """What writes the stream, if the options ask for it; InputError if it cannot."""
        yield from self.place_file(source, say)
        if self.out is not None:
            yield ForecastBag(self.out, predictor, source, self.at_least)
        if self.html is not None:
            yield ReplayFile(self.html, self.moments(predictor, title))


def run(options: Options) -> None:
    """Forecast the recording; InputError names the file or model and the reason.

    When interrupted, it finishes its files, says that they are parts, and raises
    KeyboardInterrupt.
    """
    rate = _rate_of(options)
    first = options.recording[0]

    def warn(text: str) -> None:
        warnings.warn(f"{first}: {text}", InputWarning, stacklevel=2)

    source = options.source(warn, recorded=True)
    frames = read_frames(options.recording, options.read, source)
    with contextlib.ExitStack() as stack, contextlib.ExitStack() as files:
        predictor = options.predictor(options.read.max_gap, "needed")
        analytics = Analytics(predictor)
        stitcher = options.stitcher()
        stream = Status(predictor, analytics, warn, source=source, stitcher=stitcher)
        arguments = predictor, first.stem, source
        written = [
            files.enter_context(closing(view)) for view in options.files(*arguments)
        ]
        live = [
            stack.enter_context(closing(view)) for view in options.views(*arguments)
        ]
        titles = [f"{view.title} {view.where}" for view in live]
        # In real time a page shows what is newest; a file, or a page that waits, has
        # every frame.
        if live and math.isfinite(rate) and not isinstance(options.foxglove, Path):
            live = [stack.enter_context(closing(Newest(live)))]
        events = replay(
            frames,
            predictor,
            analytics,
            rate=rate,
            stitcher=stitcher,
            robot=source.robot,
        )
        print(*titles, sep="\n", end="\n" * bool(titles), flush=True)
        interruption = _show(events, stream, [*written, *live])
        if interruption:
            places = (view.where for view in written)
            print("until the interruption:", *places, flush=True)
        scored = analytics.finish()
        for view in (*written, *live):
            view.end(analytics.summary(), scored)
        files.close()
        part = ", up to the interruption only" * bool(interruption)
        print(
            stream.table(),
            *(f"{view.title} {view.where}{part}" for view in written),
            sep="\n",
        )
        if interruption:
            raise interruption
        if options.dashboard or isinstance(options.foxglove, int):
            print("live until interrupted", flush=True)
            wait_for_signal()


def _rate_of(options: Options) -> float:
    """How many times as fast as it was recorded; infinite if nothing is waited for."""
    if options.rate is None and options.dashboard:
        return 1.0
    if options.rate is None or options.rate == "max":
        return math.inf
    return options.rate


def _show(
    events: Iterator[ReplayEvent], stream: Status, views: list[View]
) -> KeyboardInterrupt | None:
    """Show what follows from each frame; return what interrupted it, if anything did."""
    try:
        for event in events:
            stream.heard(event.frame.stamp, event.age)
            if event.forecast is not None:
                stream.published(event.age)
            for view in views:
                view.show(event, stream.now())
    except KeyboardInterrupt as interruption:
        return interruption
    return None


def wait_for_signal() -> None:
    """Wait until a signal interrupts the command."""
    while True:
        time.sleep(
            0.2
        )  # A signal that another thread takes does not end a longer wait.
