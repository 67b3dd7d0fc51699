"""Forecasts written to a file of JSON lines while they come."""

import json
from pathlib import Path
from typing import Any

import numpy as np

from neurosym_robot.online.growing_file import GrowingFile
from neurosym_robot.online.pairs import AT_LEAST, LikelyEvents
from neurosym_robot.online.predictor import Forecast
from neurosym_robot.online.replay import Event

__all__ = ["ForecastLines"]


class ForecastLines:
    """A JSON object a forecast, once its future is known; metres to the millimetre."""

    def __init__(self, path: Path, period: float, at_least: float = AT_LEAST):
        """Begin the file.

        Args:
            path: nothing is overwritten.
            period: seconds between the models' steps.
            at_least: probability from which on an event of a pair is told.

        Raises:
            InputError: where it cannot be written, or is there already.
        """
        self.path, self._period = path, period
        self._likely = LikelyEvents(period, at_least)
        self._file = GrowingFile(path)

    def add(self, event: Event) -> None:
        """Write what an event brought."""
        for done in event.scored:
            self.score(done)

    def score(self, forecast: Forecast) -> None:
        """Write one forecast whose future is known."""
        row = {
            "stamp": forecast.stamp,
            "period": self._period,
            "index": forecast.index,
            "ids": forecast.ids.tolist(),
            "observed": _rounded(forecast.observed),
            "extrapolated": forecast.extrapolated.tolist(),
            "future": _rounded(forecast.future),
            "models": {
                name: {
                    "central": result.central,
                    "samples": _rounded(result.samples),
                    "events": self._events(forecast, name),
                }
                for name, result in forecast.models.items()
            },
            "dropped": forecast.dropped,
            "latency_ms": round(1e3 * forecast.latency, 3),
        }
        self._file.write(json.dumps(row, allow_nan=False) + "\n")

    def _events(self, forecast: Forecast, model: str) -> list[dict[str, Any]]:
        """Probable ones, most probable first."""
        ids = forecast.ids.tolist()
        return [
            {
                "event": each.name,
                "k": ids[each.k],
                "l": ids[each.l],
                "probability": round(each.probability, 4),
                "seconds": round(each.seconds, 3),
            }
            for each in self._likely(forecast, model)
        ]

    def close(self) -> None:
        """Finish the file."""
        self._file.close()


def _rounded(metres: np.ndarray | None) -> Any:
    """Nested lists, with None where it is not known."""
    if metres is None:
        return None
    rounded = np.round(metres, 3).astype(object)
    rounded[~np.isfinite(metres)] = None
    return rounded.tolist()
