"""Options of every command on a stream of people, and the objects that they configure."""

import dataclasses
import functools
import signal
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

from neurosym_jax.errors import InputError
from neurosym_robot.dashboard import Dashboard
from neurosym_robot.dashboard.floor_map import read_floor_map
from neurosym_robot.dashboard.moments import Moments
from neurosym_robot.online.compilation import When
from neurosym_robot.online.pairs import AT_LEAST
from neurosym_robot.online.predictor import Predictor, load_models
from neurosym_robot.online.status import STALE_AFTER
from neurosym_robot.ros.forecasting_node import ForecastingNode
from neurosym_robot.ros.source import REACH, PeopleSource
from neurosym_robot.tracking.stitching import LinkOptions, OnlineStitcher

__all__ = ["LiveOptions", "NodeOptions"]


@dataclasses.dataclass(frozen=True, kw_only=True)
class LiveOptions:
    """Models that forecast a stream, and their settings."""

    model: tuple[Path, ...]
    """Models by name, folder or torch checkpoint; several forecast side by side."""
    period: float | None = None
    """Seconds between steps; by default those of the models' training data."""
    max_people: int = 64
    """Maximum number of people in a forecast: those nearest to the robot (--robot-frame) or to the
    centre of all people."""
    samples: int = 20
    """Number of samples of each model."""
    seed: int = 0
    """Random seed of the noise."""
    hold: float = 1.0
    """Seconds for which a person out of sight is extrapolated at constant velocity and forecast."""
    stitch: bool = False
    """Join tracks that occlusions broke."""
    links: LinkOptions = dataclasses.field(default_factory=LinkOptions)
    """With --stitch: when two tracks are joined."""
    fixed_frame: str = ""
    """Frame into which coordinates are transformed by /tf; by default that of the first message,
    and messages in other frames are left out."""
    robot_frame: str = ""
    """The robot's own frame, such as base_link: /tf locates the robot for the page, and the people
    nearest to it are forecast first."""
    reach: float = REACH
    """Metres; people farther from the sensor (the origin of coordinates that --fixed-frame
    transforms) or from the robot (--robot-frame) are left out."""
    dashboard: bool = False
    """Serve a live web page of people and forecasts."""
    port: int = 8765
    """Port of the page; 0 for any free port."""
    host: str = "127.0.0.1"
    """Address of the page; 0.0.0.0 makes it visible to other computers, without a password."""
    map: Path | None = None
    """Floor map to draw on the page: the .yaml file of a ROS map."""
    at_least: float = AT_LEAST
    """Least probability of a pair's event to show, write and publish."""

    def __post_init__(self):
        """Refuse what is no probability."""
        if not 0 < self.at_least <= 1:
            raise InputError(f"--at-least is a probability in (0, 1], not {self.at_least:g}")

    def predictor(self, compile: When = "meanwhile") -> Predictor:
        """Load the models and start compiling; InputError as of `load_models` and `Predictor`."""
        return Predictor(
            load_models(self.model),
            self.period,
            self.max_people,
            self.samples,
            self.seed,
            hold=self.hold,
            compile=compile,
            report=functools.partial(print, file=sys.stderr, flush=True),
        )

    def source(self, report: Callable[[str], None]) -> PeopleSource:
        """The stream of people; `report` is called about messages that are left out."""
        return PeopleSource(self.fixed_frame, report, self.robot_frame, self.reach)

    def stitcher(self) -> OnlineStitcher | None:
        """The stitcher of ids, if the options ask for it."""
        return OnlineStitcher(self.links) if self.stitch else None

    def moments(self, predictor: Predictor, title: str) -> Moments:
        """The lines of JSON of this predictor's stream; InputError if the map cannot be read."""
        floor_map = None if self.map is None else read_floor_map(self.map)
        return Moments(predictor, title=title, floor_map=floor_map, at_least=self.at_least)

    def page(self, predictor: Predictor, title: str) -> Dashboard | None:
        """The page, served, if the options ask for it; InputError if its address is not free."""
        if not self.dashboard:
            return None
        return Dashboard(self.moments(predictor, title), self.host, self.port)


@dataclasses.dataclass(frozen=True, kw_only=True)
class NodeOptions(LiveOptions):
    """Options of the nodes of ROS 1 and ROS 2."""

    name: str = "neurosym_jax"
    """Name of this node; on ROS 1 in $ROS_NAMESPACE, if that is set."""
    status: float = 10.0
    """Seconds between status lines; 0 for none."""
    stale_after: float = STALE_AFTER
    """Age of information in seconds from which on the stream is called stale."""

    def node_options(self, report: Callable[[str], None]) -> dict[str, Any]:
        """The options that a `ForecastingNode` takes."""
        same = ("name", "at_least", "status", "stale_after")
        options = {name: getattr(self, name) for name in same}
        return {**options, "source": self.source(report), "stitcher": self.stitcher()}

    def forecast(self, node: ForecastingNode, report: Callable[[str], None]) -> None:
        """Run a node until interrupted, with its page if there is one; then print its summary."""
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, lambda *_: node.stopped.set())
        node.dashboard = self.page(node.predictor, self.name)
        if node.dashboard is not None:
            report(f"the page is at {node.dashboard.url}")
        node.run()
        if node.dashboard is not None:
            node.dashboard.close()
        node.analytics.finish()
        print(node.status.table())
