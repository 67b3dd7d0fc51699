"""Bags written without ROS: messages, or the forecasts of a replay."""

import os
from pathlib import Path
from typing import Any

from neurosym_jax.errors import InputError
from neurosym_robot.online.pairs import AT_LEAST
from neurosym_robot.online.predictor import Forecast
from neurosym_robot.online.replay import ReplayEvent
from neurosym_robot.plugin import SUFFIXES
from neurosym_robot.ros.definitions import (
    EVENTS,
    FORECAST,
    HUMANS_TRAJS,
    PEOPLE_TOPICS,
    TRUTH_TOPIC,
    blank,
    shared_typestore,
)
from neurosym_robot.ros.messages import ENDINGS, forecast_topic, make_people, makers, truth_message
from neurosym_robot.ros.source import PeopleSource

__all__ = ["BagWriter", "ForecastBag"]


class BagWriter:
    """Writes a new bag; `with BagWriter(path) as bag` closes it whatever happens."""

    def __init__(self, path: Path):
        """Open `NAME.bag` of ROS 1, or for `NAME.db3` or `NAME.mcap` a folder `NAME` of ROS 2.

        Raises:
            InputError: for another ending, a bag that exists, or a folder that cannot be written.
        """
        path = Path(path)
        if path.suffix not in SUFFIXES:
            raise InputError(f"{path}: a bag's name ends in {', '.join(SUFFIXES)}")
        self.ros = 1 if path.suffix == ".bag" else 2
        self.path = path if self.ros == 1 else path.with_suffix("")
        if os.path.exists(self.path):
            raise InputError(f"{self.path}: already there, and nothing is overwritten")
        self._store = shared_typestore(self.ros)
        from rosbags import rosbag1, rosbag2

        self._writer: Any
        if self.ros == 1:
            self._writer = rosbag1.Writer(self.path)
        else:
            plugin = rosbag2.StoragePlugin
            storage = plugin.MCAP if path.suffix == ".mcap" else plugin.SQLITE3
            self._writer = rosbag2.Writer(self.path, version=8, storage_plugin=storage)
        self._connections: dict[str, Any] = {}
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            self._writer.open()
        except OSError as error:
            raise InputError(f"{self.path}: cannot be written ({error.strerror})") from None

    def new(self, kind: str) -> Any:
        """An empty message, by its type."""
        return blank(self._store, kind)

    def write(self, topic: str, stamp: float, message: Any) -> None:
        """Append a message, received at `stamp` seconds.

        Raises:
            InputError: for a time that ROS has no numbers for, before 1970 or after 2038.
        """
        if not 0 <= stamp < 2**31:
            raise InputError(f"{self.path}: the time {stamp} s does not fit into a bag")
        kind, store = message.__msgtype__, self._store
        if topic not in self._connections:
            self._connections[topic] = self._writer.add_connection(topic, kind, typestore=store)
        serialise = store.serialize_ros1 if self.ros == 1 else store.serialize_cdr
        self._writer.write(self._connections[topic], round(stamp * 1e9), serialise(message, kind))

    def __enter__(self) -> "BagWriter":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Write index and metadata."""
        self._writer.close()


class ForecastBag(BagWriter):
    """People, forecasts of every model and what happened, on the robot experiment's topics."""

    def __init__(self, path: Path, period: float, source: PeopleSource, at_least: float = AT_LEAST):
        """Open the bag, as `BagWriter`; `source` knows the frame of the coordinates."""
        super().__init__(path)
        self._period, self._source = period, source
        self._stamp = 0.0
        self._make = makers(at_least)

    def add(self, event: ReplayEvent) -> None:
        """Write a frame with its forecast and the futures that it completed."""
        self._stamp = event.frame.stamp
        new, forecast, frame_id = self.new, event.forecast, self._source.frame_id or "map"
        self.write(PEOPLE_TOPICS[0], self._stamp, make_people(new, event.frame, frame_id))
        for name in () if forecast is None else forecast.models:
            for kind in (HUMANS_TRAJS, FORECAST, EVENTS):
                message = self._make[kind](new, forecast, name, self._period, frame_id)
                self.write(forecast_topic(name) + ENDINGS[kind], self._stamp, message)
        for done in event.scored:
            self.score(done)

    def score(self, forecast: Forecast) -> None:
        """Write the observed future of a forecast."""
        frame_id = self._source.frame_id or "map"
        message = truth_message(self.new, forecast, self._period, frame_id)
        if message is not None:
            self.write(TRUTH_TOPIC, self._stamp, message)
