"""Options of every command on a stream of people, and the objects that they configure.

Parameters of ROS are options, too: `samples: 4` is `--samples 4`, a list is several
values, and `links: {max_gap: 3}` is `--links.max-gap 3`. An option on the command line
overrides a parameter.
"""

import contextlib
import dataclasses
import functools
import math
import signal
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

from neurosym_jax.commands._options import refuse_given
from neurosym_jax.errors import InputError, printable
from neurosym_robot import (
    Dashboard,
    LinkOptions,
    Moments,
    OnlineStitcher,
    Predictor,
    View,
    load_models,
)
from neurosym_robot.commands._place_file import PlaceFile, open_place
from neurosym_robot.dashboard.foxglove_view import FoxgloveView
from neurosym_robot.dashboard.view import Newest
from neurosym_robot.input.kinds import Kind
from neurosym_robot.input.source import REACH, PeopleSource
from neurosym_robot.online.onnx_network import OnnxModel
from neurosym_robot.online.pairs import AT_LEAST
from neurosym_robot.online.programs import When
from neurosym_robot.online.status import STALE_AFTER
from neurosym_robot.ros.forecasting_node import ForecastingNode

if TYPE_CHECKING:
    from neurosym_jax.models.forecast import Model
    from neurosym_jax.models.place.place import Place

NAME = "neurosym_jax"  # of a node


def say(text: str) -> None:
    """Print a line of a node on the standard error; names in it do not steer the terminal."""
    print(printable(text), file=sys.stderr, flush=True)


@dataclasses.dataclass(frozen=True, kw_only=True)
class LiveOptions:
    """Models that forecast a stream, and their settings."""

    # Options without effect unless one of others is given.
    NEEDS: ClassVar[dict[str, tuple[str, ...]]] = {
        "links": ("stitch",),
        "reach": ("fixed_frame", "robot_frame"),
        "position": ("people",),
        "id": ("people",),
        "port": ("dashboard",),
        "host": ("dashboard", "foxglove"),
        "map": ("dashboard",),
        "half_life": ("place",),
    }
    GROUPS: ClassVar[dict[str, str]] = {
        "data": "recording topic message fixed_frame robot_frame stitch links people "
        "position id only reach max_gap read",
        "model": "model samples place half_life period hold min_seen",
        "output": "dashboard port host map foxglove rate out html at_least status",
    }
    model: tuple[Path, ...]
    """Models by name, folder, .pt or .onnx file; several forecast side by side. An .onnx file is one of
    `neurosym export MODEL FILE.onnx --points`."""
    period: float | None = None
    """Seconds between steps; by default those of the models' training data."""
    max_people: int = 64
    """Maximum number of people in a forecast; those nearest to the robot (--robot-frame) or to the
    centre of all people."""
    samples: int = 20
    """Number of samples of each model."""
    seed: int = 0
    """Random seed of the noise."""
    hold: float = 1.0
    """Seconds for which a person out of sight is extrapolated at constant velocity and forecast."""
    min_seen: float = 0.0
    """Seconds for which a person must have been seen, and twice at least; what is missing of the
    observed window is a line through what was seen. 2.8 asks for all of a window of 2.8 s."""
    stitch: bool = False
    """Join tracks that occlusions broke."""
    links: LinkOptions = LinkOptions()  # noqa: RUF009 (frozen)
    """With --stitch: when two tracks are joined."""
    people: str = ""
    """Field of a message of any type that holds one entry per person, such as tracks."""
    position: str = "position"
    """With --people: path from an entry to its x, y and z, such as pose.pose.position."""
    id: str = ""
    """With --people: path from an entry to its id, such as track_id, or a field of the message with
    as many entries; by default each position continues the nearest expected one."""
    only: str = ""
    """Which entries are people: path and values, such as results.0.hypothesis.class_id=person;
    by default all, of derived_object_msgs those of its class for pedestrians."""
    fixed_frame: str = ""
    """Frame into which coordinates are transformed by /tf; by default that of the first message,
    and messages in other frames are left out."""
    robot_frame: str = ""
    """The robot's own frame, such as base_link; /tf locates the robot for the page, and the people
    nearest to it are forecast first."""
    reach: float = REACH
    """Distance in metres beyond which people are left out; from the sensor (the origin of
    coordinates that --fixed-frame transforms) or from the robot (--robot-frame)."""
    dashboard: bool = False
    """Serve a live web page of people and forecasts."""
    port: int = 8765
    """Port of the page; 0 for any free port."""
    host: str = "127.0.0.1"
    """Address of the page; 0.0.0.0 makes it visible to other computers, without a password."""
    foxglove: int | Path | None = None
    """Port of a websocket for Foxglove, or a new .mcap file; port 0 is any free one."""
    place: Path | None = None
    """File of what people did at this place (docs/place.md); begun where it is not there, kept while
    the stream is watched. Draws of the first model take from it; --fixed-frame is by default its
    frame."""
    half_life: float = math.inf
    """With --place: seconds of watching after which what people did counts for half."""
    map: Path | None = None
    """Floor map to draw on the page: the .yaml file of a ROS map."""
    at_least: float = AT_LEAST
    """Least probability of a pair's event; others are not shown, written or published."""

    def __post_init__(self):
        """Refuse what is no probability, and options without effect."""
        if self.only and not all(self.only.partition("=")):
            raise InputError(f"--only {self.only}: PATH=VALUE, such as label=person")
        if not 0 < self.at_least <= 1:
            raise InputError(
                f"--at-least is a probability in (0, 1], not {self.at_least:g}"
            )
        fields = dataclasses.fields(self)
        options = {
            field.name for field in fields if getattr(self, field.name) != field.default
        }
        for option, others in self.NEEDS.items():
            if options.isdisjoint(others):
                needed = " or --".join(others).replace("_", "-")
                refuse_given(f"without --{needed}", **{option: option in options})
        if isinstance(self.foxglove, Path) and not self.dashboard:
            refuse_given("on a file for Foxglove", host="host" in options)

    @property
    def needs_jax(self) -> bool:
        """Whether a model is in JAX."""
        return any(path.suffix != ".onnx" for path in self.model)

    @functools.cached_property
    def models(self) -> "dict[str, Model | OnnxModel]":
        """The models by name; InputError as of `load_models`."""
        return load_models(self.model)

    @functools.cached_property
    def watched(self) -> "Place | None":
        """The place of --place; InputError as of `open_place`, or for another frame."""
        if self.place is None:
            return None
        model = next(iter(self.models.values()))
        place = open_place(self.place, model, self.half_life)
        if place.frame and self.fixed_frame.strip("/") not in ("", place.frame):
            raise InputError(
                f"{self.place}: is of the frame {place.frame!r}, "
                f"not --fixed-frame {self.fixed_frame}: another frame is another place"
            )
        return place

    def place_file(
        self, source: PeopleSource, report: Callable[[str], None]
    ) -> Iterator[PlaceFile]:
        """What writes the file of the place, if there is one."""
        if self.place is not None and self.watched is not None:
            yield PlaceFile(self.place, self.watched, source, report)

    def predictor(self, max_gap: float, compile: When = "meanwhile") -> Predictor:
        """Load the models and start compiling; InputError as of `load_models` and `Predictor`.

        `max_gap` is the longest gap in seconds between two observations that is
        bridged.
        """
        return Predictor(
            self.models,
            self.period,
            self.max_people,
            self.samples,
            self.seed,
            hold=self.hold,
            min_seen=self.min_seen,
            place=self.watched,
            compile=compile,
            report=say,
            max_gap=max_gap,
        )

    def source(
        self, report: Callable[[str], None], recorded: bool = False
    ) -> PeopleSource:
        """The stream of people; `report` is called about messages that are left out."""
        form = Kind(self.people, self.position, self.id) if self.people else None
        place = "" if self.watched is None else self.watched.frame
        frames = self.fixed_frame or place, report, self.robot_frame
        return PeopleSource(*frames, self.reach, form, self.only, recorded=recorded)

    def stitcher(self) -> OnlineStitcher | None:
        """The stitcher of ids, if the options ask for it."""
        return OnlineStitcher(self.links) if self.stitch else None

    def moments(self, predictor: Predictor, title: str) -> Moments:
        """The lines of JSON of this predictor's stream; InputError if the map cannot be read."""
        return Moments(
            predictor, title=title, floor_map=self.map, at_least=self.at_least
        )

    def views(
        self, predictor: Predictor, title: str, source: PeopleSource
    ) -> Iterator[View]:
        """What shows the stream live, if the options ask for it; InputError if it cannot."""
        if self.dashboard:
            yield Dashboard(self.moments(predictor, title), self.host, self.port)
        if self.foxglove is not None:
            yield FoxgloveView(
                predictor,
                self.foxglove,
                self.host,
                frame_id=lambda: source.frame_id,
                at_least=self.at_least,
            )


@dataclasses.dataclass(frozen=True, kw_only=True)
class NodeOptions(LiveOptions):
    """Options of the nodes of ROS 1 and ROS 2."""

    FIRST: ClassVar[str] = (
        "topic message fixed_frame stitch model samples place dashboard"
    )

    name: str = NAME
    """Name of this node; on ROS 1 in $ROS_NAMESPACE, if that is set."""
    status: float = 10.0
    """Seconds between status lines; 0 for none."""
    stale_after: float = STALE_AFTER
    """Age of information in seconds from which on the stream is called stale."""
    max_gap: float = 1.0
    """Longest gap in seconds between two observations that is bridged; a tracker slower than 1 Hz
    needs more."""

    def node_options(self, report: Callable[[str], None]) -> dict[str, Any]:
        """The options that a `ForecastingNode` takes."""
        same = ("name", "at_least", "status", "stale_after")
        return {
            **{name: getattr(self, name) for name in same},
            "source": self.source(report),
            "stitcher": self.stitcher(),
        }

    def forecast(self, node: ForecastingNode) -> None:
        """Run a node until interrupted, with what shows it; print its summary, and close it."""
        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
            signal.signal(number, lambda *_: node.stopped.set())
        with contextlib.ExitStack() as stack:
            stack.callback(node.close)
            chosen = self.views(node.predictor, self.name, node.source)
            views = [stack.enter_context(contextlib.closing(view)) for view in chosen]
            for file in self.place_file(node.source, node.report):
                node.views.append(stack.enter_context(contextlib.closing(file)))
            if views:
                node.views.append(
                    stack.enter_context(contextlib.closing(Newest(views)))
                )
            for view in views:
                node.report(f"{view.title} {view.where}")
            node.run()
            node.analytics.finish()
            print(node.status.table())


def value_of(arguments: Sequence[str], option: str, otherwise: str) -> str:
    """The value of an option before options are read."""
    for place, argument in enumerate(arguments):
        name, equals, value = argument.partition("=")
        if name == option:
            return value if equals else " ".join(arguments[place + 1 : place + 2])
    return otherwise


def as_options(parameters: Any, within: str = "") -> Iterator[str]:
    """The parameters of a node as options of a command line."""
    for key, value in parameters.items() if isinstance(parameters, Mapping) else ():
        option = within + key.replace("_", "-")
        if isinstance(value, Mapping):
            yield from as_options(value, f"{option}.")
        elif isinstance(value, bool):
            yield f"--{option}" if value else f"--no-{option}"
        elif isinstance(value, str | int | float):
            yield f"--{option}={value}"
        elif value:  # A list; an empty one is an option that is not given.
            yield from (f"--{option}", *map(str, value))
