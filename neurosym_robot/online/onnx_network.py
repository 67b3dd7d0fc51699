"""A model in ONNX Runtime, as `neurosym export MODEL FILE.onnx --points` writes it: without JAX."""

import functools
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from neurosym_jax.errors import InputError, optional_module
from neurosym_robot.online.coupling import draw_scenes, even_lots
from neurosym_robot.online.window import Observed


class Lengths(NamedTuple):
    """What a window needs to know of a model."""

    obs_len: int
    pred_len: int
    period: float


class OnnxModel:
    """A model in a file; what a predictor asks of a `Model`."""

    weighting = None
    params: Mapping[str, Any] = {}

    def __init__(self, file: Path | str):
        """Load the file, for one thread.

        Raises:
            InputError: without onnxruntime, or for what is no such model.
        """
        runtime = optional_module("onnxruntime", "an .onnx model", "robot-light")
        options = runtime.SessionOptions()
        options.intra_op_num_threads = options.inter_op_num_threads = 1
        # More takes half a second at the start, and frames are not faster.
        level = runtime.GraphOptimizationLevel.ORT_ENABLE_BASIC
        options.graph_optimization_level = level
        try:
            self.session = runtime.InferenceSession(str(file), options)
            facts = self.session.get_modelmeta().custom_metadata_map
            inputs = {row.name: row.shape for row in self.session.get_inputs()}
            shapes = {row.name: row.shape for row in self.session.get_outputs()}
            period = float(facts["period"])
            steps = inputs["observed"][1], shapes["forecasts"][2]
            self.name, self.noise = facts["model"], facts["noise"]
        except Exception as error:  # Its own errors have no common class.
            reason = " ".join(str(error).split()) or type(error).__name__
            raise InputError(
                f"{file}: not a model that `neurosym export` wrote: {reason}"
            ) from None
        if "noise" in inputs:
            raise InputError(f"{file}: takes noise; models of anchors take none")
        self.config = Lengths(*steps, period)
        self.samples = shapes["forecasts"][0]
        self.outputs = [*shapes]
        self.takes_short = "seen" in inputs
        """Whether it is told which steps were seen."""


class Pending(NamedTuple):
    """The forecast of N people."""

    origin: np.ndarray
    """[2] metres: float32 would lose millimetres far from 0."""
    observed: np.ndarray
    """[N, obs_len, 2] metres from the origin."""
    results: Mapping[str, np.ndarray]
    """By name: forecasts, probabilities and points, from the origin."""


class OnnxNetwork:
    """Forecasts scenes with an `OnnxModel`; the counterpart of `networks.Network`."""

    repairs = True
    """Networks of anchors mend tracks themselves."""

    def __init__(self, model: OnnxModel, samples: int, seed: int, most: int):
        """Of up to `most` people; random numbers are the same in all frames.

        Raises:
            InputError: for another number of samples than the file has.
        """
        if samples != model.samples:
            raise InputError(
                f"samples: {model.name} was exported with {model.samples}, not {samples}"
            )
        self.samples, self._model = samples, model
        half = -(-samples // 2)
        self._lots = [even_lots(2 * seed + view, most, half) for view in range(2)]

    @staticmethod
    def sizes(most: int) -> set[int]:
        """None: it forecasts any number of people, and nothing is compiled."""
        return set()

    def start(
        self, observed: Observed, recording: str, frame: int, slots: int
    ) -> Pending:
        """Forecast people by their windows, whether every step of them was seen or not."""
        origin = np.median(observed.positions[:, -1], axis=0)
        positions = (observed.positions - origin).astype(np.float32)
        inputs = {"observed": positions}
        if self._model.takes_short:
            inputs["seen"] = observed.sighted
        results = self._model.session.run(None, inputs)
        return Pending(origin, positions, dict(zip(self._model.outputs, results)))

    def finish(self, pending: Pending) -> tuple[np.ndarray, np.ndarray | None]:
        """The samples [k, N, pred_len, 2] in metres, and their probabilities [k]."""
        samples = pending.results["forecasts"] + pending.origin
        return samples, pending.results["probabilities"].astype(np.float64)

    def drawing(
        self,
        pending: Pending,
        samples: np.ndarray,
        central: int | None,
        recording: str,
        memory: None = None,
    ) -> Callable[[], np.ndarray]:
        """What draws [k, N, pred_len, 2] metres."""
        return functools.partial(self._draw, pending, samples)

    def _draw(self, pending: Pending, samples: np.ndarray) -> np.ndarray:
        if "points" not in pending.results:
            # Each sample about as often as it is probable.
            probability = pending.results["probabilities"].cumsum()
            place = (np.arange(self.samples) + 0.5) / self.samples
            chosen = np.searchsorted(probability, place * probability[-1])
            return samples[np.minimum(chosen, self.samples - 1)]
        people = samples.shape[1]
        period = self._model.config.period
        draws = []
        # Half of them from what is seen in a mirror, as in `AnchorTableForecaster`.
        for points, lots in zip(np.split(pending.results["points"], 2), self._lots):
            scene = points, pending.observed, lots[:, :people]
            draws.append(draw_scenes(*scene, period))
        draws = np.stack(draws, axis=1).reshape(-1, *samples.shape[1:])
        return draws[: self.samples] + pending.origin
