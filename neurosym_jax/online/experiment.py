"""`python -m neurosym_jax experiment`: the robot paper's experiment, on simulated recordings.

Mghames et al., "neuROSym: Deployment and Evaluation of a ROS-based Neuro-Symbolic Model for Human
Motion Prediction" (2024): two scenarios, two recordings of two minutes each, SGAN beside NeuroSyM.
Here a simulation walks, a tracker with faults sees it, and a bag keeps what the tracker says; the
bag is read back, tracks are stitched, forecast and scored as they would be on the robot. What is
made of the results is in `online.experiment_report`.
"""

import dataclasses
import time
from pathlib import Path
from typing import Any

import numpy as np

from neurosym_jax.data.synthetic import Scenario, simulate_labelled
from neurosym_jax.data.tracker import TrackerFaults
from neurosym_jax.errors import InputError
from neurosym_jax.evaluation.cases import SHIPPED
from neurosym_jax.evaluation.metrics import scene_errors
from neurosym_jax.forecast import Model
from neurosym_jax.online.analytics import Analytics
from neurosym_jax.online.bags import BagWriter, read_people
from neurosym_jax.online.identity import idf1
from neurosym_jax.online.live_options import load_models
from neurosym_jax.online.live_stitching import OnlineStitcher
from neurosym_jax.online.messages import PEOPLE_TOPICS, Frame, make_people
from neurosym_jax.online.predictor import Forecast, Predictor
from neurosym_jax.online.recordings import frames_of_tracks
from neurosym_jax.online.replay import replay

__all__ = ["ExperimentOptions", "Recording", "Score", "complete", "experiment", "published"]

FAULTS = TrackerFaults(noise=0.02, dropout=0.005, dropout_seconds=1.0, id_switch=1.0)
"""Each person is lost every 20 s on average, for 1 s on average, and comes back under a new id."""
PEOPLE = 2
STEPS = (8, 8)
"""Observed and forecast, as the paper's models."""
START = 1.7e9
"""Seconds, of the first message: a robot's clock counts from 1970."""
STORAGES = (".bag", ".mcap", ".db3", ".bag")
"""Of the four recordings; the chain is the same for all."""


@dataclasses.dataclass(frozen=True)
class ExperimentOptions:
    """Repeat the robot paper's experiment on simulated recordings, and write its report."""

    out: Path = Path("results/experiment")
    """Folder for report, figures and recordings; it must be new or empty."""
    model_a: tuple[Path, ...] = ()
    """Models for scenario A; by default those that ship for zara1."""
    model_b: tuple[Path, ...] = ()
    """Models for scenario B; by default those trained on THÖR that ship, else those of A."""
    seconds: float = 120.0
    """Length of a recording."""
    seeds: tuple[int, int, int, int] = (1, 2, 3, 4)
    """Of the recordings, two of A and two of B."""
    samples: int = 20
    """Futures that each model draws."""


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
    """Their ids, stitched."""
    people: list[np.ndarray]
    """Who they truly are."""
    forecasts: list[Forecast]
    """Those that were scored."""
    summary: dict[str, Any]
    """Of the analytics."""
    unstitched: dict[str, Any]
    """Of the analytics, had nothing been stitched."""
    scores: dict[str, Score]

    @property
    def identity(self) -> tuple[float, float]:
        """IDF1 of the tracker's ids and of the stitched ones."""
        people = np.concatenate(self.people)
        given = np.concatenate([frame.ids for frame in self.frames])
        return idf1(people, given), idf1(people, np.concatenate(self.mended))


def experiment(options: ExperimentOptions) -> None:
    """Do what the verb says.

    Raises:
        InputError: for models that are not there, or a folder that holds something.
    """
    from neurosym_jax.online.experiment_report import write_report

    if options.out.exists() and (not options.out.is_dir() or any(options.out.iterdir())):
        raise InputError(f"{options.out}: already there, and nothing is overwritten")
    began = time.perf_counter()
    model_a = options.model_a or _shipped("zara1")
    if not model_a:
        raise InputError("no shipped models in this installation: give --model-a")
    chosen: dict[Scenario, tuple[Path, ...]] = {
        "all-forward": model_a,
        "cross-path": options.model_b or _shipped("thor") or model_a,
    }
    recordings, latencies = [], {}
    walks = iter(zip(options.seeds, STORAGES))
    for scenario, paths in chosen.items():
        models = load_models(paths)
        if any((m.config.obs_len, m.config.pred_len) != STEPS for m in models.values()):
            raise InputError(
                f"the experiment's models observe {STEPS[0]} steps, forecast {STEPS[1]}"
            )
        here: list[Recording] = []
        for number in (1, 2):
            bag, people = _record(scenario, number, *next(walks), options.seconds, options.out)
            here.append(_forecast(scenario, number, bag, people, models, options))
            print(f"{scenario} {number}: {len(here[-1].forecasts)} forecasts of {bag.name}")
        latencies[scenario] = _latency(models, here[0], options)
        recordings += here
    page = write_report(options, chosen, recordings, latencies)
    print(f"the report is {page} ({time.perf_counter() - began:.0f} s)")


def _shipped(scene: str) -> tuple[Path, ...]:
    """An SGAN and a NeuroSyM that ship for a scene, at 8 + 8; none if not both do."""
    kinds = [sorted(SHIPPED.glob(f"{kind}_{scene}*_8_8")) for kind in ("sgan", "neurosym")]
    return tuple(paths[0] for paths in kinds) if all(kinds) else ()


def _record(
    scenario: Scenario, number: int, seed: int, storage: str, seconds: float, out: Path
) -> tuple[Path, list[np.ndarray]]:
    """A bag of what the tracker says of a walk, and who the people of each frame are."""
    tracks, person = simulate_labelled(scenario, seed, seconds, PEOPLE, FAULTS)
    path = out / "recordings" / f"{scenario}_{number}{storage}"
    with BagWriter(path) as bag:
        for frame in frames_of_tracks(tracks):
            frame = frame._replace(stamp=START + frame.stamp)
            bag.write(PEOPLE_TOPICS[0], frame.stamp, make_people(bag.types, frame))
    # In the order of each frame's tracks, which is that of the tracker's ids.
    order = np.lexsort((tracks.id, tracks.stamp))
    cuts = np.flatnonzero(np.diff(tracks.stamp[order])) + 1
    return bag.path, np.split(person[order], cuts)


def _forecast(
    scenario: Scenario,
    number: int,
    bag: Path,
    people: list[np.ndarray],
    models: dict[str, Model],
    options: ExperimentOptions,
) -> Recording:
    """The way of a recording through the whole chain, and once more without stitching."""
    frames = list(read_people(bag))
    summaries, done, mended = [], [], []
    for stitcher in (None, OnlineStitcher()):
        predictor = _predictor(models, bag, options)
        analytics = Analytics()
        events = list(replay(frames, predictor, analytics, stitcher=stitcher))
        done = [each for event in events for each in event.scored] + analytics.finish()
        mended = [event.frame.ids for event in events]
        summaries.append(analytics.summary())
    scores = {name: _score(done, name) for name in models}
    scores["constant velocity"] = _score(done, None)
    unstitched, summary = summaries
    return Recording(
        scenario, number, bag, frames, mended, people, done, summary, unstitched, scores
    )


def _predictor(models: dict[str, Model], bag: Path, options: ExperimentOptions) -> Predictor:
    return Predictor(models, samples=options.samples, max_people=4, recording=bag.stem)


def complete(forecasts: list[Forecast]) -> list[Forecast]:
    """Those of everybody, with everybody's future known."""
    return [
        each
        for each in forecasts
        if len(each.ids) == PEOPLE and each.future is not None and np.isfinite(each.future).all()
    ]


def published(forecast: Forecast, model: str | None) -> np.ndarray:
    """[N, pred_len, 2] the most central sample of a model; constant velocity if None."""
    if model is not None:
        result = forecast.models[model]
        return result.samples[result.central]
    assert forecast.future is not None
    steps = np.arange(1, forecast.future.shape[1] + 1)[:, None]
    last, step = forecast.observed[:, -1:], np.diff(forecast.observed[:, -2:], axis=1)
    return last + steps * step


def _score(forecasts: list[Forecast], model: str | None) -> Score:
    kept = complete(forecasts)
    if not kept:
        raise InputError("no sequence in which both people are known: the recording is too short")
    future = np.array([forecast.future for forecast in kept])
    distance = np.linalg.norm(
        np.stack([published(forecast, model) for forecast in kept]) - future, axis=-1
    )
    samples = [published(f, None)[None] if model is None else f.models[model].samples for f in kept]
    best = scene_errors(
        np.concatenate(samples, axis=1),
        np.concatenate(list(future)),
        np.full(len(kept), PEOPLE),
    )
    people = len(kept) * PEOPLE
    return Score(
        sequences=len(kept),
        ade=float(distance.mean()),
        fde=float(distance[..., -1].mean()),
        best_ade=float(best.joint_ade.sum() / people),
        best_fde=float(best.joint_fde.sum() / people),
        sum_ade=float(distance.sum(axis=(1, 2)).mean()),
        sum_fde=float(distance[..., -1].sum(axis=1).mean()),
        horizon=distance.mean(axis=(0, 1)).tolist(),
    )


def _latency(
    models: dict[str, Model], recording: Recording, options: ExperimentOptions
) -> dict[str, dict[str, float]]:
    """Milliseconds from a frame's arrival to its forecast, of each model alone."""
    latencies = {}
    for name, model in models.items():
        analytics, stitcher = Analytics(), OnlineStitcher()
        predictor = _predictor({name: model}, recording.bag, options)
        for _ in replay(recording.frames, predictor, analytics, stitcher=stitcher):
            pass
        latencies[name] = analytics.summary()["latency_ms"]
    return latencies
