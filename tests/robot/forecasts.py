"""Forecasts made by hand."""

from collections.abc import Mapping

import numpy as np

from neurosym_robot.online.predictor import Forecast, ModelForecast


def made_forecast(
    observed: np.ndarray,
    models: Mapping[str, ModelForecast],
    *,
    stamp: float = 0.0,
    index: int = 0,
    ids: np.ndarray | None = None,
    dropped: Mapping[int, str] | None = None,
    extrapolated: np.ndarray | None = None,
    **fields,
) -> Forecast:
    """A forecast of people who were seen all the time, unless it is said otherwise."""
    people = len(observed)
    dropped = {} if dropped is None else dropped
    values = {
        "seen": np.full(people, 0.4 * (observed.shape[1] - 1)),
        "whereabouts": np.full((len(dropped), 2), np.nan),
    }
    return Forecast(
        stamp=stamp,
        index=index,
        ids=np.arange(people) if ids is None else ids,
        observed=observed,
        models=models,
        dropped=dropped,
        latency=1e-3,
        extrapolated=np.zeros(people, int) if extrapolated is None else extrapolated,
        **values | fields,
    )
