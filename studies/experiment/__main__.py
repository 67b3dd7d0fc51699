r"""The robot paper's experiment, on simulated recordings.

Mghames et al., "neuROSym: Deployment and Evaluation of a ROS-based Neuro-Symbolic Model
for Human Motion Prediction" (2024): two scenarios, two recordings of two minutes each,
SGAN beside NeuroSyM. Here a simulation walks, a tracker with faults sees it, and a bag
keeps what the tracker says; the bag is read back, tracks are stitched, forecast and
scored as they would be on the robot. What is made of the results is in `report`.
`python -m studies.experiment --help` lists the options.

Networks that learned from THÖR and MAGNI, THOR being a folder with their three
recordings:

for M in sgan neurosym; do
    neurosym train --family $M --obs-len 8 --pred-len 8 --data THOR --out RUNS/$M --train-on \
        CLiFF-LHMP_thor1_exp-1-run-2 CLiFF-LHMP_thor3_exp-3-run-2 THOR-MAGNI_Scenario_5
done
python -m studies.experiment --out OUT --models RUNS/sgan RUNS/neurosym
"""

import itertools
import sys
from pathlib import Path

import numpy as np
import tyro

from neurosym_jax.errors import InputError
from neurosym_jax.models.forecast import Model
from neurosym_jax.runtime.process import enable_compilation_cache, tune
from neurosym_jax.simulation.scenarios import Scenario, simulate_labelled
from neurosym_robot.online.predictor import Predictor, load_models
from neurosym_robot.online.replay import STRAIGHT, Analytics, replay
from neurosym_robot.ros.bags import BagWriter, read_people
from neurosym_robot.ros.definitions import PEOPLE_TOPICS
from neurosym_robot.ros.messages import make_people
from neurosym_robot.tracking.following import frames_of_tracks
from neurosym_robot.tracking.stitching import OnlineStitcher
from studies.experiment.report import write_report
from studies.experiment.results import FAULTS, MODELS, PEOPLE, SEEDS, Recording, score

__all__ = ["experiment"]

START = 1.7e9  # seconds, of the first message: a robot's clock counts from 1970
MAX_PEOPLE = 4
STORAGES = (".bag", ".mcap", ".db3", ".bag")
"""Formats of the four bags; the chain is the same for all."""


def experiment(
    out: Path,
    *,
    seconds: float = 120.0,
    samples: int = 20,
    models: tuple[str, str] = MODELS,
) -> Path:
    """Simulate, record, forecast, score, and write the report; its path.

    Args:
        out: folder for report, figures and recordings; it must be new or empty.
        seconds: length of a recording.
        samples: futures that each model draws.
        models: an SGAN and a NeuroSyM, names or folders.

    Raises:
        InputError: for a folder that holds something.
    """
    if out.exists() and (not out.is_dir() or any(out.iterdir())):
        raise InputError(f"{out}: already there, and nothing is overwritten")
    loaded = load_models([Path(name) for name in models])
    # By how the names of tables begin: the first is an SGAN, the second a NeuroSyM.
    networks = {
        model.name.split(",")[0].split(" (")[0]: model for model in loaded.values()
    }
    recordings, latencies = [], {}
    storages = iter(STORAGES)
    for scenario, seeds in SEEDS.items():
        for number, seed in enumerate(seeds, 1):
            bag, people = _record(scenario, number, seed, next(storages), seconds, out)
            recordings.append(
                _forecast(scenario, number, bag, people, networks, samples)
            )
            done = len(recordings[-1].forecasts)
            print(f"{scenario} {number}: {done} forecasts of {bag.name}")
        latencies[scenario] = _latency(networks, recordings[-2], samples)
    return write_report(out, recordings, latencies, seconds, models)


def _record(
    scenario: Scenario, number: int, seed: int, storage: str, seconds: float, out: Path
) -> tuple[Path, list[np.ndarray]]:
    """A bag of what the tracker says of a walk, and who the people of each frame are."""
    tracks, person = simulate_labelled(scenario, seed, seconds, PEOPLE, FAULTS)
    path = out / "recordings" / f"{scenario}_{number}{storage}"
    with BagWriter(path) as bag:
        for frame in frames_of_tracks(tracks):
            frame = frame._replace(stamp=START + frame.stamp)
            bag.write(PEOPLE_TOPICS[0], frame.stamp, make_people(bag.new, frame))
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
    samples: int,
) -> Recording:
    """The way of a recording through the whole chain, and once more without stitching."""
    frames, again = list(read_people(bag)), OnlineStitcher()
    mended = [again.push(*frame) for frame in frames]
    summaries, done = [], []
    for stitcher in (None, OnlineStitcher()):
        predictor = Predictor(models, samples=samples, max_people=MAX_PEOPLE)
        analytics = Analytics(predictor)
        events = list(replay(frames, predictor, analytics, stitcher=stitcher))
        scored = itertools.chain(*(event.scored for event in events))
        done = [*scored, *analytics.finish()]
        summaries.append(analytics.summary())
    scores = {name: score(done, name) for name in models}
    scores[STRAIGHT] = score(done, None)
    unstitched, summary = summaries
    return Recording(
        scenario, number, bag, frames, mended, people, done, summary, unstitched, scores
    )


def _latency(
    models: dict[str, Model], recording: Recording, samples: int
) -> dict[str, float]:
    """Median milliseconds from a frame's arrival to its forecast, of each model alone."""
    latencies = {}
    for name, model in models.items():
        predictor = Predictor({name: model}, samples=samples, max_people=MAX_PEOPLE)
        analytics, stitcher = Analytics(predictor), OnlineStitcher()
        events = replay(recording.frames, predictor, analytics, stitcher=stitcher)
        took = [
            1e3 * event.forecast.latency
            for event in events
            if event.forecast is not None
        ]
        latencies[name] = float(np.median(took))
    return latencies


if __name__ == "__main__":
    tune()
    enable_compilation_cache()
    try:
        print(f"the report is {tyro.cli(experiment)}")
    except InputError as error:
        sys.exit(f"error: {error}")
