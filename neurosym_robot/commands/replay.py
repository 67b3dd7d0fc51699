"""Forecast a recording as if it were live."""

import contextlib
import dataclasses
import math
import signal
import threading
import warnings
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from typing import Literal

from neurosym_jax.commands._options import Positional, Reading, refuse_given, refuse_unused
from neurosym_jax.data.reading import AS_IT_SAYS
from neurosym_jax.errors import InputWarning
from neurosym_robot import Analytics, Predictor, ReplayFile, Status, View, read_frames, replay
from neurosym_robot.commands._live_options import LiveOptions
from neurosym_robot.dashboard.dashboard import Newest
from neurosym_robot.ros.definitions import is_bag
from neurosym_robot.ros.forecasting_node import ForecastBag
from neurosym_robot.ros.people import REACH, PeopleSource


@dataclasses.dataclass(frozen=True, kw_only=True)
class Options(LiveOptions):
    """Forecast a recording frame by frame, and score the forecasts."""

    NEEDS = LiveOptions.NEEDS | {
        "map": ("dashboard", "html"),
        "at_least": ("out", "html", "dashboard", "foxglove"),
    }
    recording: Positional[Path]
    """A bag (ROS 1 `.bag`; folder, `.db3` or `.mcap` of ROS 2), or a file of tracks."""
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
        if not is_bag(self.recording):
            # Bags and Foxglove tell the name of the coordinates' frame.
            named = self.out is not None or self.foxglove is not None
            unused = {"fixed_frame": self.fixed_frame and not named, "reach": self.reach != REACH}
            refuse_given("on a file of tracks", robot_frame=self.robot_frame, **unused)

    def files(self, predictor: Predictor, title: str, source: PeopleSource) -> Iterator[View]:
        """What writes the stream, if the options ask for it; InputError if it cannot."""
        if self.out is not None:
            yield ForecastBag(self.out, predictor, source, self.at_least)
        if self.html is not None:
            yield ReplayFile(self.html, self.moments(predictor, title))


def run(options: Options) -> None:
    """Forecast the recording; InputError names the file or model and the reason."""
    rate = options.rate if options.rate is not None else 1.0 if options.dashboard else "max"

    def warn(text: str) -> None:
        warnings.warn(f"{options.recording}: {text}", InputWarning, stacklevel=2)

    refuse_unused(options.read, ["max_gap"], "on a stream")
    source = options.source(warn)
    frames = read_frames(options.recording, options.read, source)
    with contextlib.ExitStack() as stack, contextlib.ExitStack() as files:
        # Files are finished on SIGTERM, too.
        before = signal.signal(signal.SIGTERM, signal.default_int_handler)
        stack.callback(signal.signal, signal.SIGTERM, before)
        predictor = options.predictor("needed")
        analytics = Analytics(predictor)
        status = Status(predictor, analytics, warn, counts=lambda: source.refused)
        what = predictor, options.recording.stem, source
        written = [files.enter_context(closing(view)) for view in options.files(*what)]
        live = [stack.enter_context(closing(view)) for view in options.views(*what)]
        told = [f"{view.title} {view.where}" for view in live]
        # In real time a page shows what is newest; a file, or a page that waits, has every frame.
        if live and rate != "max" and not isinstance(options.foxglove, Path):
            live = [stack.enter_context(closing(Newest(live)))]
        events = replay(
            frames,
            predictor,
            analytics,
            rate=math.inf if rate == "max" else rate,
            stitcher=options.stitcher(),
            robot=source.robot,
        )
        try:
            print(*told, sep="\n", end="\n" * bool(told), flush=True)
            for event in events:
                if event.forecast is not None:
                    status.published(event.age)
                for view in (*written, *live):
                    view.show(event, status.now())
        except KeyboardInterrupt:
            print("interrupted; until then:")
        scored = analytics.finish()
        for view in (*written, *live):
            view.end(analytics.summary(), scored)
        files.close()
        print(status.table(), *(f"{view.title} {view.where}" for view in written), sep="\n")
        if options.dashboard or isinstance(options.foxglove, int):
            print("live until interrupted", flush=True)
            never = threading.Event()
            with contextlib.suppress(KeyboardInterrupt):
                # A signal that another thread takes does not end a longer wait.
                while not never.wait(0.2):
                    pass
