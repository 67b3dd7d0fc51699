"""A robot crosses a hall of people, with and without forecasts: `python -m studies.driving`.

The halls are those of `studies.stitching`, seeds 0 to 199. People do not see the robot, and a 10 Hz
tracker with its losses sees them. Every 0.4 s the robot takes the best of 33 velocities by what it
believes of people: that they stand, go straight on, or do what one of 20 sampled futures says.
"""

import sys
from pathlib import Path

import numpy as np

from neurosym_jax.data.tracks import Tracks, resample
from neurosym_robot.online.predictor import Predictor, load_models
from neurosym_robot.online.replay import straight
from neurosym_robot.tracking.following import frames_of_tracks
from studies.stitching.situations import hall

__all__ = ["drive", "main"]

EPISODES, BEGIN, LONGEST = 200, 10.0, 30.0  # seconds of a hall's minute
START, GOAL = np.array([0.0, 7.5]), np.array([15.0, 7.5])
PERIOD, STEPS = 0.4, 8
CONTACT, KEPT = 0.5, 0.7  # metres between two centres: a collision, and what is planned for
RISK, FADE = (
    2.0,
    0.85,
)  # a certain contact in units of 3.2 m of way, and each step later counts less
ANGLES = np.linspace(0, 2 * np.pi, 16, endpoint=False)
VELOCITIES = np.concatenate(
    [np.zeros((1, 2)), *(s * np.stack([np.cos(ANGLES), np.sin(ANGLES)], 1) for s in (0.5, 1.0))]
)
Belief = tuple[np.ndarray, np.ndarray]
"""Samples [k, N, STEPS, 2] and their weights [k]."""


def beliefs(tracks: Tracks, predictor: Predictor) -> dict[str, list[Belief]]:
    """What is believed of everybody in sight at each moment of planning."""
    (model,) = predictor.models
    found: dict[str, list[Belief]] = {"people stand": [], "constant velocity": [], model: []}
    times = iter(BEGIN + PERIOD * np.arange(round(LONGEST / PERIOD)))
    due = next(times)
    for frame in frames_of_tracks(tracks):
        predictor.window.push(*frame)
        while frame.stamp > due + 1e-6:  # Nobody was in sight.
            for each in found.values():
                each.append((np.zeros((1, 0, STEPS, 2)), np.ones(1)))
            due = next(times, np.inf)
        if frame.stamp < due - 1e-6:
            continue
        stamps = [frame.stamp - PERIOD, frame.stamp]
        pair = predictor.window.resampled(frame.ids, stamps)
        pair = np.where(np.isfinite(pair), pair, frame.xy[:, None])  # New ones stand.
        ids, one = frame.ids, np.ones(1)
        found["people stand"].append((np.repeat(pair[None, :, 1:], STEPS, axis=2), one))
        found["constant velocity"].append((straight(pair, STEPS)[None], one))
        found[model].append(found["constant velocity"][-1])
        forecast = predictor.forecast()
        if forecast is not None:
            (result,) = forecast.models.values()
            new = ~np.isin(ids, forecast.ids)
            others = np.repeat(straight(pair[new], STEPS)[None], len(result.samples), axis=0)
            samples = np.concatenate([result.samples[:, :, :STEPS], others], axis=1)
            found[model][-1] = samples, result.weights
        due = next(times, np.inf)
    return found


def drive(people: np.ndarray, seen: list[Belief]) -> list[float]:
    """Collision (0 or 1), least distance, way [m] and time [s] of a robot among `people`.

    They are [F, N, 2] metres at 10 Hz, NaN where nobody is.
    """
    robot, least, way, every = START.copy(), np.inf, 0.0, round(10 * PERIOD)
    for n, (samples, weights) in enumerate(seen):
        ahead = PERIOD * np.arange(1, STEPS + 1)[:, None]
        places = robot + VELOCITIES[:, None] * ahead
        apart = np.linalg.norm(places[:, None, None] - samples, axis=-1)  # [V, k, N, STEPS]
        touched = (apart < KEPT).any(axis=2) * FADE ** np.arange(STEPS)
        chance = touched.max(axis=2) @ weights
        nearest = np.linalg.norm(places - GOAL, axis=-1).min(axis=1)
        progress = np.linalg.norm(robot - GOAL) - nearest
        velocity = VELOCITIES[np.argmax(progress / (PERIOD * STEPS) - RISK * chance)]
        for here in people[n * every + 1 : (n + 1) * every + 1]:
            robot = robot + velocity / 10
            least = min(least, np.nanmin(np.linalg.norm(here - robot, axis=-1), initial=np.inf))
        way += PERIOD * float(np.linalg.norm(velocity))
        if np.linalg.norm(robot - GOAL) < 0.5:
            break
    return [float(least < CONTACT), float(min(least, 3.0)), way, PERIOD * (n + 1)]


def main(episodes: int) -> None:
    """Print a table in Markdown: means and their 95 % intervals."""
    rows: dict[str, list[list[float]]] = {}
    predictor = Predictor(load_models([Path("recommended")]), hold=1.0, max_people=32)
    for seed in range(episodes):
        tracks, person = hall(seed)
        known = tracks.take(person >= 0).with_ids(person[person >= 0])
        whole = resample(known, 0.1, LONGEST)
        frame = np.rint(10 * (whole.stamp - BEGIN)).astype(int)
        inside = (frame >= 0) & (frame <= 10 * LONGEST)
        people = np.full((round(10 * LONGEST) + 1, whole.id.max() + 1, 2), np.nan)
        people[frame[inside], whole.id[inside]] = whole.position[inside]
        for name, seen in beliefs(known, predictor).items():
            rows.setdefault(name, []).append(drive(people, seen))
    print("| what the robot believes | collisions, % | least distance, m | way, m | time, s |")
    print("|---|---:|---:|---:|---:|")
    tables = {name: np.array(each) * [100, 1, 1, 1] for name, each in rows.items()}
    *_, straight_on, forecast = tables.values()
    tables["difference of the last two"] = forecast - straight_on
    for name, table in tables.items():
        mean, half = table.mean(axis=0), 1.96 * table.std(axis=0, ddof=1) / len(table) ** 0.5
        print(f"| {name} |", " | ".join(f"{m:.2f} ± {h:.2f}" for m, h in zip(mean, half)), "|")


if __name__ == "__main__":
    main(int(sys.argv[1]) if sys.argv[1:] else EPISODES)
