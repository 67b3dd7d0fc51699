"""How probable the states of those pairs are that come nearest to each other, step by step ahead.

Probabilities are `symbolic.forecast`'s. As with events nothing is computed with the forecast
itself, but for whoever asks.
"""

import jax
import numpy as np

from neurosym_jax.symbolic.forecast import SymbolicForecast, symbolic_forecast
from neurosym_jax.symbolic.futures import SymbolSettings
from neurosym_robot.online.likely import PAIRS, nearest_pairs
from neurosym_robot.online.predictor import Forecast, Predictor

__all__ = ["PairStates"]


class PairStates:
    """From a forecast to the states of its nearest pairs, by one program for all of them."""

    def __init__(self, period: float):
        """Nothing is compiled yet.

        Args:
            period: seconds between the models' steps.
        """
        self.settings = SymbolSettings(period=period)
        """Of the symbols."""

    @classmethod
    def of(cls, predictor: Predictor) -> "PairStates":
        """The states of what `predictor` forecasts, compiled with its programs."""
        states = cls(predictor.window.period)
        lengths = {model.config.pred_len for model in predictor.models.values()}

        def compile(size: int) -> None:
            for steps in lengths:
                for count in predictor.samples:
                    ways = np.zeros((count, 2 * PAIRS, steps, 2))
                    states._of(ways, ways[0, :, :1])

        predictor.programs.add(compile, predictor.programs.sizes[:1])
        return states

    def __call__(self, forecast: Forecast, model: str) -> tuple[np.ndarray, SymbolicForecast]:
        """What `model` makes of the pairs.

        Returns:
            [P, 2] rows of k and l among the forecast's people, nearest first, `PAIRS` at most; and
            their probabilities as numpy's arrays.
        """
        result = forecast.models[model]
        near = nearest_pairs(result.mean)
        # Always as many, so that one program serves all.
        ends = np.resize(near if len(near) else [[0, 0]], (PAIRS, 2)).T.ravel()
        found = self._of(result.samples[:, ends], forecast.observed[ends, -1:])
        return near, jax.tree.map(lambda each: np.asarray(each)[: len(near)], found)

    def _of(self, samples: np.ndarray, last: np.ndarray) -> SymbolicForecast:
        """Of those in the first half of `samples [k, 2 PAIRS, T, 2]` with those in the second."""
        pairs = np.arange(2 * PAIRS).reshape(2, -1).T
        return symbolic_forecast(samples, last, pairs=pairs, period=self.settings.period)
