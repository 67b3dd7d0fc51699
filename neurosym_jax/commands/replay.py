"""Forecast a recording as if it were live."""

import contextlib
import dataclasses
import math
import threading
from pathlib import Path
from typing import Annotated, Literal

import tyro

from neurosym_jax.dashboard.options import ViewOptions, make_moments, open_dashboard
from neurosym_jax.dashboard.replay_file import ReplayFile
from neurosym_jax.data.reading import AS_IT_SAYS, ReadOptions
from neurosym_jax.online.analytics import Analytics
from neurosym_jax.online.forecast_files import open_forecast_file
from neurosym_jax.online.live_options import LiveOptions, make_predictor
from neurosym_jax.online.recordings import read_frames
from neurosym_jax.online.replay import replay as events_of
from neurosym_jax.online.summary import format_summary
from neurosym_jax.ros.bags import frame_id_of, is_bag
from neurosym_jax.tracking.live import OnlineStitcher

__all__ = ["Options", "run"]


@dataclasses.dataclass(frozen=True, kw_only=True)
class Options(LiveOptions):
    """Forecast a recording frame by frame, and score the forecasts."""

    recording: Annotated[Path, tyro.conf.Positional]
    """A bag (ROS 1 `.bag`; folder, `.db3` or `.mcap` of ROS 2), or a file of tracks."""
    topic: str | None = None
    """Of the people in a bag; found by itself where there is only one."""
    read: Annotated[ReadOptions, tyro.conf.OmitArgPrefixes] = AS_IT_SAYS
    """How a file of tracks is read."""
    rate: float | Literal["max"] | None = None
    """1 is as fast as it was, and so it is with --dashboard by default; else max."""
    stitch: bool = False
    """Join the tracks that occlusions broke."""
    out: Path | None = None
    """Forecasts and what happened: `.bag`, `.db3`, `.mcap` or `.jsonl`; nothing is overwritten."""
    frame_id: str = ""
    """The coordinates' frame, in a bag that is written; by default that of a bag read, else map."""
    view: Annotated[ViewOptions, tyro.conf.OmitArgPrefixes] = dataclasses.field(
        default_factory=ViewOptions
    )
    html: Path | None = None
    """The page of --dashboard with everything inside, to share; nothing is overwritten."""


def run(options: Options) -> None:
    """Do what the verb says.

    Raises:
        InputError: naming the file, and what is wrong with it or with a model.
    """
    live = options.view.dashboard
    rate = options.rate if options.rate is not None else 1.0 if live else "max"
    stitcher = OnlineStitcher() if options.stitch else None
    frames = read_frames(options.recording, options.topic, options.read)
    analytics, title = Analytics(), options.recording.stem
    with contextlib.ExitStack() as stack:
        predictor = make_predictor(options, title)
        out = page = dashboard = None
        if options.out is not None:
            frame_id = options.frame_id
            if not frame_id and is_bag(options.recording):
                frame_id = frame_id_of(options.recording, options.topic)
            out = open_forecast_file(options.out, predictor.window.period, frame_id or "map")
            stack.callback(out.close)
        if options.html is not None:
            page = ReplayFile(options.html, make_moments(options.view, predictor, title))
            stack.callback(page.close)
        if live:
            dashboard = open_dashboard(options.view, predictor, title)
            stack.callback(dashboard.close)
            print(f"the page is at {dashboard.url}", flush=True)
        views = [view for view in (page, dashboard) if view is not None]
        events = events_of(
            frames,
            predictor,
            analytics,
            rate=math.inf if rate == "max" else rate,
            stitcher=stitcher,
        )
        try:
            for event in events:
                if out is not None:
                    out.add(event)
                for view in views:
                    view.show(event.frame, event.forecast, analytics.summary())
        except KeyboardInterrupt:
            print("interrupted; until then:")
        for done in analytics.finish():
            if out is not None:
                out.score(done)
        for view in views:
            view.end(analytics.summary())
        print(format_summary(analytics.summary(), predictor.health), flush=True)
        for written in (out, page):
            if written is not None:
                print(f"forecasts are in {written.path}", flush=True)
        if dashboard is not None:
            print(f"the page stays at {dashboard.url} until interrupted", flush=True)
            with contextlib.suppress(KeyboardInterrupt):
                threading.Event().wait()
