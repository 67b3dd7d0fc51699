"""Forecast a recording as if it were live."""

import contextlib
import dataclasses
import math
import signal
import threading
import warnings
from pathlib import Path
from typing import Annotated, Literal

import tyro

from neurosym_jax.data.reading import AS_IT_SAYS, ReadOptions
from neurosym_jax.errors import InputWarning
from neurosym_robot.commands._live_options import LiveOptions
from neurosym_robot.dashboard import ReplayFile
from neurosym_robot.online.analytics import Analytics
from neurosym_robot.online.replay import replay
from neurosym_robot.online.status import Status
from neurosym_robot.ros.bag_writer import ForecastBag
from neurosym_robot.ros.bags import read_frames

__all__ = ["Options", "run"]


@dataclasses.dataclass(frozen=True, kw_only=True)
class Options(LiveOptions):
    """Forecast a recording frame by frame, and score the forecasts."""

    recording: Annotated[Path, tyro.conf.Positional]
    """A bag (ROS 1 `.bag`; folder, `.db3` or `.mcap` of ROS 2), or a file of tracks."""
    read: Annotated[ReadOptions, tyro.conf.OmitArgPrefixes] = AS_IT_SAYS
    """How the recording is read."""
    rate: float | Literal["max"] | None = None
    """Speed: 1 is real time (default with --dashboard), max does not wait (default otherwise)."""
    out: Path | None = None
    """Bag of forecasts and observed futures to write: `.bag`, `.db3` or `.mcap`; nothing is
    overwritten."""
    html: Path | None = None
    """HTML file to write: the page of --dashboard with its data inside; nothing is overwritten."""


def run(options: Options) -> None:
    """Forecast the recording; InputError names the file or model and the reason."""
    rate = options.rate if options.rate is not None else 1.0 if options.dashboard else "max"

    def warn(text: str) -> None:
        warnings.warn(f"{options.recording}: {text}", InputWarning, stacklevel=2)

    source = options.source(warn)
    frames = read_frames(options.recording, options.read, source)
    title = options.recording.stem
    with contextlib.ExitStack() as stack:
        # Files are finished on SIGTERM, too.
        before = signal.signal(signal.SIGTERM, signal.default_int_handler)
        stack.callback(signal.signal, signal.SIGTERM, before)
        predictor = options.predictor("needed")
        analytics = Analytics(predictor)
        status = Status(predictor, analytics, warn, counts=lambda: source.refused)
        files = stack.enter_context(contextlib.ExitStack())
        bag = page = None
        if options.out is not None:
            bag = ForecastBag(options.out, predictor.window.period, source, options.at_least)
            files.callback(bag.close)
        if options.html is not None:
            page = ReplayFile(options.html, options.moments(predictor, title))
            files.callback(page.close)
        dashboard = options.page(predictor, title)
        if dashboard is not None:
            stack.callback(dashboard.close)
            print(f"the page is at {dashboard.url}", flush=True)
        views = [each for each in (page, dashboard) if each is not None]
        stitcher, speed = options.stitcher(), math.inf if rate == "max" else rate
        events = replay(
            frames, predictor, analytics, rate=speed, stitcher=stitcher, robot=source.robot
        )
        try:
            for event in events:
                if event.forecast is not None:
                    status.published(event.age)
                if bag is not None:
                    bag.add(event)
                for each in views:
                    each.show(event, status.now(), source.robot(event.frame.stamp))
        except KeyboardInterrupt:
            print("interrupted; until then:")
        for done in analytics.finish():
            if bag is not None:
                bag.score(done)
        for each in views:
            each.end(analytics.summary())
        print(status.table(), flush=True)
        files.close()
        for written in (bag, page):
            if written is not None:
                print(f"forecasts are in {written.path}", flush=True)
        if dashboard is not None:
            print(f"the page stays at {dashboard.url} until interrupted", flush=True)
            with contextlib.suppress(KeyboardInterrupt):
                threading.Event().wait()
