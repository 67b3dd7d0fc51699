"""Forecasts written to a file of JSON lines while they come."""

import json
from pathlib import Path
from typing import Any

import numpy as np

from neurosym_robot.online.growing_file import GrowingFile
from neurosym_robot.online.pairs import AT_LEAST, LikelyEvents
from neurosym_robot.online.predictor import Forecast
from neurosym_robot.online.replay import ReplayEvent

__all__ = ["ForecastLines"]


class ForecastLines:
    """A JSON object per forecast, once its future is known; metres to the millimetre."""

    def __init__(self, path: Path, period: float, at_least: float = AT_LEAST):
        """Begin the file; InputError if it exists or cannot be written."""
        self.path, self._period = path, period
        self._likely = LikelyEvents(period, at_least)
        self._file = GrowingFile(path)

    def add(self, event: ReplayEvent) -> None:
        """Write the forecasts whose future a frame completed."""
        for done in event.scored:
            self.score(done)

    def score(self, forecast: Forecast) -> None:
        """Write a forecast whose future is known."""
        models = {
            name: {
                "central": result.central,
                "samples": _rounded(result.samples),
                "events": [
                    {
                        "event": each.name,
                        "k": int(forecast.ids[each.k]),
                        "l": int(forecast.ids[each.l]),
                        "probability": round(each.probability, 4),
                        "seconds": round(each.seconds, 3),
                    }
                    for each in self._likely(forecast, name)
                ],
            }
            for name, result in forecast.models.items()
        }
        row = {
            "stamp": forecast.stamp,
            "period": self._period,
            "index": forecast.index,
            "ids": forecast.ids.tolist(),
            "observed": _rounded(forecast.observed),
            "extrapolated": forecast.extrapolated.tolist(),
            "future": None if forecast.future is None else _rounded(forecast.future),
            "models": models,
            "dropped": forecast.dropped,
            "latency_ms": round(1e3 * forecast.latency, 3),
        }
        self._file.write(json.dumps(row, allow_nan=False) + "\n")

    def close(self) -> None:
        """Finish the file."""
        self._file.close()


def _rounded(metres: np.ndarray) -> Any:
    """Nested lists, with None for NaN."""
    rounded = np.round(metres, 3).astype(object)
    rounded[~np.isfinite(metres)] = None
    return rounded.tolist()
