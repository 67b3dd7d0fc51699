"""Forecasts of people whom a robot has hardly seen: `python -m studies.newcomers DATA [SEEDS]`.

Real tracks as a robot sees them, with people hidden by others and errors of 5 cm, go
through `--stitch` and `recommended`. DATA holds SGAN's files of ETH/UCY. Printed are the
share of visible people who have a forecast, and by seconds seen the error of the central
forecast and the energy score of the draws, beside constant velocity. Nothing was chosen
on seeds from 0 on.
"""

import sys
from collections import defaultdict
from pathlib import Path

import numpy as np

from neurosym_jax.data.clock import resample
from neurosym_jax.data.recordings import read_any
from neurosym_robot.online.predictor import Forecast, Predictor, load_models
from neurosym_robot.online.replay import straight
from neurosym_robot.tracking.following import Frame
from neurosym_robot.tracking.stitching import OnlineStitcher
from studies.tracking import RATE, RECORDINGS, Sensor, observe

__all__ = ["collect", "energy", "main"]

BINS = np.array([0.0, 0.15, 0.35, 0.75, 1.55, 2.75, np.inf])
"""Bounds of the seconds seen."""
EVERY = 10
"""Frames from one forecast that is scored to the next."""
NEAR = 0.5
"""Metres between a person and a detection of them at most."""


def energy(draws: np.ndarray, truth: np.ndarray) -> float:
    """Mean energy score over steps of `draws [k, T, 2]` against `truth [T, 2]`, metres."""
    count = len(draws)
    error = np.linalg.norm(draws - truth, axis=-1).mean(axis=0)
    apart = np.linalg.norm(draws[:, None] - draws, axis=-1).sum(axis=(0, 1))
    return float((error - apart / (2 * count * (count - 1))).mean())


def collect(file: Path, seed: int, predictor: Predictor) -> tuple[np.ndarray, float]:
    """Rows [R, 4] of who was forecast, and the share of visible people with a forecast.

    A row is seconds seen, the errors of the central forecast and of constant velocity,
    and the energy score, metres.
    """
    (tracks,) = read_any(file)
    stream = observe(tracks, seed, Sensor())
    steady = resample(tracks, 1 / RATE, 2.0)
    keys = np.rint(RATE * steady.stamp).astype(int).tolist()
    truth = dict(zip(zip(steady.id.tolist(), keys), steady.position))
    stitcher, rows, shares = OnlineStitcher(), [], []
    period = predictor.window.period
    count = round(predictor.seconds_ahead / period)
    steps = round(RATE * period) * np.arange(1, count + 1)
    for n, stamp in enumerate(stream.stamps.tolist()):
        frame = stitcher.mend(Frame(stamp, stream.ids[n], stream.xy[n]))
        predictor.window.push(*frame)
        if n % EVERY:
            continue
        forecast = predictor.forecast()
        for person, place in zip(stream.people[n].tolist(), stream.places[n]):
            off = np.linalg.norm(frame.xy - place, axis=1)
            id = frame.ids[off.argmin()] if off.min(initial=np.inf) < NEAR else -1
            (row,) = np.nonzero(forecast.ids == id)
            shares.append(len(row) > 0)
            now = round(RATE * stamp)
            future = [truth.get((person, now + step)) for step in steps.tolist()]
            if len(row) and all(place is not None for place in future):
                rows.append(_score(forecast, int(row[0]), np.array(future)))
    return np.array(rows), float(np.mean(shares))


def _score(forecast: Forecast, row: int, truth: np.ndarray) -> list[float]:
    (result,) = forecast.models.values()
    steps = result.samples.shape[2]
    going_on = straight(forecast.observed[row : row + 1], steps)[0]
    ways = result.samples[result.central, row], going_on
    errors = [float(np.linalg.norm(way - truth, axis=-1).mean()) for way in ways]
    return [float(forecast.seen[row]), *errors, energy(result.draws[:, row], truth)]


def main(folder: Path, seeds: range) -> None:
    """Print a table in Markdown: means over people by seconds seen."""
    models = load_models([Path("recommended")])
    scores, shares = defaultdict(list), []
    for file in RECORDINGS.values():
        for seed in seeds:
            predictor = Predictor(models, compile="needed", hold=1.0, min_seen=0.0)
            rows, share = collect(folder / f"{file}.txt", seed, predictor)
            shares.append(share)
            for place, row in zip(np.digitize(rows[:, 0], BINS) - 1, rows):
                scores[int(place)].append(row)
    print(f"with a forecast: {100 * np.mean(shares):.1f} % of those visible")
    print("| seconds seen | people | central ADE | constant velocity | energy score |")
    print("|---|---:|---:|---:|---:|")
    for place in sorted(scores):
        table = np.array(scores[place])
        seen, *means = table.mean(axis=0)
        numbers = " | ".join(f"{mean:.3f}" for mean in means)
        print(f"| {seen:.1f} | {len(table)} | {numbers} |")


if __name__ == "__main__":
    count = int(sys.argv[2]) if len(sys.argv) > 2 else 3
    main(Path(sys.argv[1]), range(count))
