"""What the robot experiment measures: a recording's forecasts, and a model's errors on them."""

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np

from neurosym_jax.errors import InputError
from neurosym_jax.evaluation.scores import score as score_scene
from neurosym_jax.simulation.scenarios import Scenario, TrackerFaults
from neurosym_robot.online.predictor import Forecast
from neurosym_robot.online.replay import straight
from neurosym_robot.tracking.following import Frame
from studies.experiment.identity import idf1

__all__ = [
    "FAULTS",
    "MODELS",
    "PEOPLE",
    "SEEDS",
    "Recording",
    "Score",
    "complete",
    "published",
]
__all__ += ["score"]

PEOPLE = 2
MODELS = ("sgan_zara1_8", "neurosym_zara1_8")
SEEDS: dict[Scenario, tuple[int, int]] = {"all-forward": (1, 2), "cross-path": (3, 4)}
"""Seeds of the two recordings of each scenario."""
FAULTS = TrackerFaults(noise=0.02, dropout=0.005, dropout_seconds=1.0, id_switch=1.0)
"""Each person is lost every 20 s on average, for 1 s on average, and comes back under a new id."""


@dataclasses.dataclass(frozen=True)
class Score:
    """A model on a recording: means over the sequences in which both people are known."""

    sequences: int
    ade: float
    """Metres, mean over people and steps, of the forecast that is published: the most central."""
    fde: float
    """Metres, the same of the last step."""
    best_ade: float
    """Metres, joint best of k."""
    best_fde: float
    sum_ade: float
    """Metres, of the published forecast, summed over people and steps: the paper's "Avg. ADE"."""
    sum_fde: float
    """Metres, summed over people."""
    horizon: list[float]
    """[pred_len] metres, mean over people, of the published forecast."""


@dataclasses.dataclass(frozen=True, eq=False)
class Recording:
    """One recording, read back and forecast."""

    scenario: Scenario
    number: int
    bag: Path
    frames: list[Frame]
    """As the tracker named people."""
    mended: list[np.ndarray]
    """Stitched ids of each frame."""
    people: list[np.ndarray]
    """Who they truly are."""
    forecasts: list[Forecast]
    """Those that were scored."""
    summary: dict[str, Any]
    """Summary of the analytics."""
    unstitched: dict[str, Any]
    """Summary of the analytics without stitching."""
    scores: dict[str, Score]

    @property
    def identity(self) -> tuple[float, float]:
        """IDF1 of the tracker's ids and of the stitched ones."""
        people = np.concatenate(self.people)
        tracked = np.concatenate([frame.ids for frame in self.frames])
        return idf1(people, tracked), idf1(people, np.concatenate(self.mended))


def complete(forecasts: list[Forecast]) -> list[Forecast]:
    """Return the forecasts that cover all people and whose futures are all known."""
    return [
        forecast
        for forecast in forecasts
        if len(forecast.ids) == PEOPLE
        and forecast.future is not None
        and np.isfinite(forecast.future).all()
    ]


def published(forecast: Forecast, model: str | None) -> np.ndarray:
    """[N, pred_len, 2] the most central sample of a model; constant velocity if None."""
    if model is not None:
        result = forecast.models[model]
        return result.samples[result.central]
    assert forecast.future is not None
    return straight(forecast.observed, forecast.future.shape[1])


def score(forecasts: list[Forecast], model: str | None) -> Score:
    """Return the errors of a model, or of constant velocity if None.

    Raises:
        InputError: if no forecast covers all people.
    """
    known_forecasts = complete(forecasts)
    if not known_forecasts:
        raise InputError(
            "no sequence in which both people are known: the recording is too short"
        )
    future = np.array([forecast.future for forecast in known_forecasts])
    distance = np.linalg.norm(
        np.stack([published(forecast, model) for forecast in known_forecasts]) - future,
        axis=-1,
    )
    samples = [
        published(f, None)[None] if model is None else f.models[model].samples
        for f in known_forecasts
    ]
    best = [
        score_scene(scene_samples, truth, metrics=("joint_ade", "joint_fde"))
        for scene_samples, truth in zip(samples, future)
    ]
    people = len(known_forecasts) * PEOPLE
    return Score(
        sequences=len(known_forecasts),
        ade=float(distance.mean()),
        fde=float(distance[..., -1].mean()),
        best_ade=float(sum(errors["joint_ade"].total[0] for errors in best) / people),
        best_fde=float(sum(errors["joint_fde"].total[0] for errors in best) / people),
        sum_ade=float(distance.sum(axis=(1, 2)).mean()),
        sum_fde=float(distance[..., -1].sum(axis=1).mean()),
        horizon=distance.mean(axis=(0, 1)).tolist(),
    )
