"""The options that every command on a stream of people has, and what they describe."""

import dataclasses
import functools
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Annotated

import tyro

from neurosym_robot.dashboard import Dashboard
from neurosym_robot.dashboard.floor_map import read_floor_map
from neurosym_robot.dashboard.moments import Moments
from neurosym_robot.online.likely import AT_LEAST, LikelyEvents
from neurosym_robot.online.models import load_models
from neurosym_robot.online.predictor import Predictor
from neurosym_robot.online.programs import When
from neurosym_robot.ros.source import Source
from neurosym_robot.tracking.linking import LinkOptions
from neurosym_robot.tracking.live import OnlineStitcher
from neurosym_robot.tracking.motion import FAR, MAX_SPEED

__all__ = ["LiveOptions", "SourceOptions", "ViewOptions"]


@dataclasses.dataclass(frozen=True)
class ViewOptions:
    """A web page of what is seen and forecast."""

    dashboard: bool = False
    """Serve the page while it goes on."""
    port: int = 8765
    """Of the page; 0 for any that is free."""
    host: str = "127.0.0.1"
    """Address to serve at; 0.0.0.0 lets other computers look, without a password."""
    map: Path | None = None
    """The floor underneath: a ROS map's .yaml."""

    at_least: float = AT_LEAST
    """Probability from which on an event of a pair is told, here and to others."""

    def moments(self, predictor: Predictor, title: str) -> Moments:
        """How this predictor's stream is told.

        Raises:
            InputError: where the map cannot be read, or for a probability that is none.
        """
        LikelyEvents.of(predictor, self.at_least)  # Compiled before it is asked for.
        return Moments(
            predictor.models,
            predictor.window.period,
            title=title,
            floor_map=None if self.map is None else read_floor_map(self.map),
            reset_after=predictor.window.reset_after,
            far=predictor.window.far,
            at_least=self.at_least,
        )

    def open(self, predictor: Predictor, title: str) -> Dashboard | None:
        """A dashboard that serves already, where one is asked for.

        Raises:
            InputError: where the map cannot be read, or the address cannot be had.
        """
        if not self.dashboard:
            return None
        dashboard = Dashboard(self.moments(predictor, title), self.host, self.port)
        dashboard.start()
        return dashboard


@dataclasses.dataclass(frozen=True)
class SourceOptions:
    """Which messages of people belong to the stream."""

    fixed_frame: str = ""
    """Frame that coordinates are taken to by /tf; without one they stay in that of the first
    message, and those in another are left out."""
    several_publishers: bool = False
    """Take in all publishers of the topic; else those beside the first are left out."""
    robot_frame: str = ""
    """The robot's own frame, such as base_link: by /tf it is drawn, and of more people than are
    forecast those who are nearest to it go first."""

    def source(self, report: Callable[[str], None]) -> Source:
        """What takes in the messages, and tells `report` of those it leaves out."""
        return Source(self.fixed_frame, self.several_publishers, report, self.robot_frame)


@dataclasses.dataclass(frozen=True, kw_only=True)
class LiveOptions:
    """Which models forecast a stream, and how."""

    model: tuple[Path, ...]
    """Folders of models, or torch checkpoints; several forecast side by side."""
    period: float | None = None
    """Seconds between steps; default: those that the models were trained on."""
    max_people: int = 64
    """In a forecast; of more, the nearest to the robot (--robot-frame) or to the middle."""
    samples: int = 20
    """Futures that each model draws."""
    seed: int = 0
    """Of the noise."""
    hold: float = 1.0
    """Seconds for which somebody unseen is still forecast, from where they would be."""
    far: float = FAR
    """Metres; people with a coordinate as large are left out: trackers put there whom they lost."""
    max_speed: float = MAX_SPEED
    """Metres per second; who moves faster from one frame to the next is somebody new."""
    stitch: bool = False
    """Join the tracks that occlusions broke."""
    links: LinkOptions = dataclasses.field(default_factory=LinkOptions)
    """With --stitch: when two tracks may be one person's."""
    stream: Annotated[SourceOptions, tyro.conf.OmitArgPrefixes] = SourceOptions()
    view: Annotated[ViewOptions, tyro.conf.OmitArgPrefixes] = dataclasses.field(
        default_factory=ViewOptions
    )

    def predictor(self, compile: When = "meanwhile") -> Predictor:
        """Load the models and begin to compile.

        Raises:
            InputError: as `load_models` and `Predictor` do.
        """
        return Predictor(
            load_models(self.model),
            self.period,
            self.max_people,
            self.samples,
            self.seed,
            hold=self.hold,
            far=self.far,
            max_speed=self.max_speed,
            compile=compile,
            report=functools.partial(print, file=sys.stderr, flush=True),
        )

    def stitcher(self) -> OnlineStitcher | None:
        """What mends ids, where that is asked for."""
        if not self.stitch:
            return None
        return OnlineStitcher(self.links, far=self.far, max_speed=self.max_speed)
