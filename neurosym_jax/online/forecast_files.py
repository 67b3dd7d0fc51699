"""Forecasts written to a file while they come: a bag, or JSON lines."""

import json
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from neurosym_jax.errors import InputError
from neurosym_jax.online.predictor import Forecast
from neurosym_jax.online.replay import Event
from neurosym_jax.ros.bags import SUFFIXES, BagWriter
from neurosym_jax.ros.forecast_messages import forecast_message, truth_message
from neurosym_jax.ros.messages import PEOPLE_TOPICS, TRUTH_TOPIC, forecast_topic, make_people

__all__ = ["ForecastFile", "open_forecast_file"]


class ForecastFile(Protocol):
    """Where a replay's events go."""

    path: Path

    def add(self, event: Event) -> None:
        """Write what an event brought."""
        ...

    def score(self, forecast: Forecast) -> None:
        """Write one forecast whose future is known, of those that waited at the end."""
        ...

    def close(self) -> None:
        """Finish the file."""
        ...


def open_forecast_file(path: Path, period: float, frame_id: str = "map") -> ForecastFile:
    """A new file: `.bag`, `.db3`, `.mcap` (see `BagWriter`), or `.jsonl`.

    Args:
        path: nothing is overwritten.
        period: seconds between the models' steps.
        frame_id: of the coordinates, in a bag.

    Raises:
        InputError: for another ending, or where it cannot be written.
    """
    if path.suffix in SUFFIXES:
        return _Bag(path, period, frame_id)
    if path.suffix == ".jsonl":
        return _Lines(path, period)
    raise InputError(f"{path}: forecasts go to {', '.join(SUFFIXES)} or .jsonl")


class _Bag:
    """People, forecasts of every model and what happened, on the robot experiment's topics."""

    def __init__(self, path: Path, period: float, frame_id: str):
        self._bag = BagWriter(path)
        self.path = self._bag.path
        self._say: dict[str, Any] = {
            "types": self._bag.types,
            "period": period,
            "frame_id": frame_id,
        }
        self._now = 0.0

    def add(self, event: Event) -> None:
        self._now = event.frame.stamp
        people = make_people(self._bag.types, event.frame, self._say["frame_id"])
        self._bag.write(PEOPLE_TOPICS[0], self._now, people)
        forecast = event.forecast
        if forecast is not None:
            for name in forecast.models:
                message = forecast_message(forecast=forecast, model=name, **self._say)
                self._bag.write(forecast_topic(name), self._now, message)
        for done in event.scored:
            self.score(done)

    def score(self, forecast: Forecast) -> None:
        message = truth_message(forecast=forecast, **self._say)
        if message is not None:
            self._bag.write(TRUTH_TOPIC, self._now, message)

    def close(self) -> None:
        self._bag.close()


class _Lines:
    """A JSON object a forecast, once its future is known; metres to the millimetre."""

    def __init__(self, path: Path, period: float):
        self.path, self._period = path, period
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            self._file = path.open("x")
        except FileExistsError:
            raise InputError(f"{path}: already there, and nothing is overwritten") from None
        except OSError as error:
            raise InputError(f"{path}: cannot be written ({error.strerror})") from None

    def add(self, event: Event) -> None:
        for done in event.scored:
            self.score(done)

    def score(self, forecast: Forecast) -> None:
        row = {
            "stamp": forecast.stamp,
            "period": self._period,
            "index": forecast.index,
            "ids": forecast.ids.tolist(),
            "observed": _rounded(forecast.observed),
            "future": _rounded(forecast.future),
            "models": {
                name: {"central": result.central, "samples": _rounded(result.samples)}
                for name, result in forecast.models.items()
            },
            "dropped": forecast.dropped,
            "latency_ms": round(1e3 * forecast.latency, 3),
        }
        self._file.write(json.dumps(row, allow_nan=False) + "\n")

    def close(self) -> None:
        self._file.close()


def _rounded(metres: np.ndarray | None) -> Any:
    """Nested lists, with None where it is not known."""
    if metres is None:
        return None
    rounded = np.round(metres, 3).astype(object)
    rounded[~np.isfinite(metres)] = None
    return rounded.tolist()
