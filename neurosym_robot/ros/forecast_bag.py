"""Forecasts written to a bag while they come."""

from pathlib import Path
from typing import Any

from neurosym_robot.online.likely import AT_LEAST
from neurosym_robot.online.predictor import Forecast
from neurosym_robot.online.replay import Event
from neurosym_robot.ros.bags import BagWriter
from neurosym_robot.ros.definitions import EVENTS, FORECAST, STATES
from neurosym_robot.ros.forecast_messages import forecast_message, truth_message
from neurosym_robot.ros.messages import PEOPLE_TOPICS, TRUTH_TOPIC, forecast_topic, make_people
from neurosym_robot.ros.outgoing import ENDINGS, makers

__all__ = ["ForecastBag"]


class ForecastBag:
    """People, forecasts of every model and what happened, on the robot experiment's topics."""

    def __init__(
        self, path: Path, period: float, frame_id: str = "map", at_least: float = AT_LEAST
    ):
        """Begin the bag.

        Args:
            path: see `BagWriter`.
            period: seconds between the models' steps.
            frame_id: of the coordinates.
            at_least: probability from which on an event of a pair is told.

        Raises:
            InputError: as `BagWriter` does.
        """
        self._bag = BagWriter(path)
        self.path = self._bag.path
        self._stamp = 0.0
        self._common: dict[str, Any] = {"period": period, "frame_id": frame_id}
        self._make = makers(at_least)

    def add(self, event: Event) -> None:
        """Write what an event brought."""
        self._stamp = event.frame.stamp
        people = make_people(self._bag.types, event.frame, self._common["frame_id"])
        self._bag.write(PEOPLE_TOPICS[0], self._stamp, people)
        forecast = event.forecast
        if forecast is not None:
            for name in forecast.models:
                told: dict[str, Any] = {"forecast": forecast, "model": name, **self._common}
                topic = forecast_topic(name)
                self._bag.write(topic, self._stamp, forecast_message(self._bag.types, **told))
                for kind in (FORECAST, EVENTS, STATES):
                    message = self._make[kind](self._bag.new, **told)
                    self._bag.write(topic + ENDINGS[kind], self._stamp, message)
        for done in event.scored:
            self.score(done)

    def score(self, forecast: Forecast) -> None:
        """Write what happened after one forecast whose future is known."""
        message = truth_message(self._bag.types, forecast, **self._common)
        if message is not None:
            self._bag.write(TRUTH_TOPIC, self._stamp, message)

    def close(self) -> None:
        """Finish the bag."""
        self._bag.close()
