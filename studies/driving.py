"""A robot crosses a hall of people, with and without forecasts: `python -m studies.driving`.

The halls are those of `studies.stitching`, seeds 0 to 199. People do not see the robot, and a 10 Hz
tracker with its losses sees them. Every 0.4 s the robot takes the best of 33 velocities by what it
believes of people: that they stand, go straight on, or do what one of 20 sampled futures says.
"""

from collections import defaultdict
from pathlib import Path

import numpy as np

from neurosym_jax.data.clock import resample
from neurosym_jax.data.tracks import Tracks
from neurosym_robot.online.predictor import Predictor, load_models
from neurosym_robot.online.replay import straight
from neurosym_robot.tracking.following import Frame, frames_of_tracks
from studies.stitching.situations import hall

__all__ = ["beliefs", "drive", "main"]

EPISODES, BEGIN, LONGEST = 200, 100, 300  # the last two in frames of 0.1 s
START, GOAL = np.array([0.0, 7.5]), np.array([15.0, 7.5])
PERIOD, EVERY, STEPS = 0.4, 4, 8
CONTACT, KEPT = 0.5, 0.7  # metres between two centres: a collision, and what is planned for
RISK, FADE = 2.0, 0.85  # of a contact, in units of 3.2 m of way; each step later counts less
ANGLES = np.linspace(0, 2 * np.pi, 16, endpoint=False)
WAYS = np.stack([np.cos(ANGLES), np.sin(ANGLES)], axis=1)
VELOCITIES = np.concatenate([np.zeros((1, 2)), 0.5 * WAYS, WAYS])
Belief = tuple[np.ndarray, np.ndarray]  # samples [k, N, STEPS, 2] and their weights [k]


def beliefs(tracks: Tracks, predictor: Predictor) -> dict[str, list[Belief]]:
    """What is believed of everybody in sight at each moment of planning."""
    history: dict[str, list[Belief]] = defaultdict(list)
    seen = {round(10 * frame.stamp): frame for frame in frames_of_tracks(tracks)}
    for n in range(BEGIN + LONGEST):
        stamp, ids, xy = seen.get(n, Frame(n / 10, np.zeros(0, int), np.zeros((0, 2))))
        predictor.window.push(stamp, ids, xy)
        if n < BEGIN or n % EVERY:
            continue
        pair = predictor.window.resampled(ids, [stamp - PERIOD, stamp])
        pair = np.where(np.isfinite(pair), pair, xy[:, None])  # New ones stand.
        for name, last_two in (("people stand", pair[:, [1, 1]]), ("constant velocity", pair)):
            history[name].append((straight(last_two, STEPS)[None], np.ones(1)))
        (model,), forecast = predictor.models, predictor.forecast()
        belief = history["constant velocity"][-1]
        if forecast is not None:
            result = forecast.models[model]
            others = belief[0][:, ~np.isin(ids, forecast.ids)].repeat(len(result.samples), axis=0)
            belief = np.append(result.samples[:, :, :STEPS], others, axis=1), result.weights
        history[model].append(belief)
    return history


def drive(people: np.ndarray, seen: list[Belief]) -> list[float]:
    """Collision (0 or 1), least distance, way [m] and time [s] of a robot among `people`.

    They are [F, N, 2] metres at 10 Hz, NaN where nobody is.
    """
    robot, least, way = START.copy(), 3.0, 0.0
    for n, (samples, weights) in enumerate(seen):
        places = robot + VELOCITIES[:, None] * PERIOD * np.arange(1, STEPS + 1)[:, None]
        distance = np.linalg.norm(places[:, None, None] - samples, axis=-1)  # [V, k, N, STEPS]
        touched = (distance < KEPT).any(axis=2) * FADE ** np.arange(STEPS)
        left = np.linalg.norm(places - GOAL, axis=-1).min(axis=1)
        cost = left / (PERIOD * STEPS) + RISK * touched.max(axis=2) @ weights
        velocity = VELOCITIES[np.argmin(cost)]
        for places_now in people[n * EVERY + 1 : (n + 1) * EVERY + 1]:
            robot = robot + velocity / 10
            least = np.nanmin(np.linalg.norm(places_now - robot, axis=-1), initial=least)
        way += PERIOD * float(np.linalg.norm(velocity))
        if np.linalg.norm(robot - GOAL) < 0.5:
            break
    return [float(least < CONTACT), float(least), way, PERIOD * (n + 1)]


def main() -> None:
    """Print a table in Markdown: means and their 95 % intervals."""
    rows: dict[str, list[list[float]]] = defaultdict(list)
    predictor = Predictor(load_models([Path("recommended")]), hold=1.0, max_people=32)
    for seed in range(EPISODES):
        tracks, person = hall(seed)
        tracked = tracks.take(person >= 0).with_ids(person[person >= 0])
        steady = resample(tracked, 0.1, LONGEST / 10)
        people = np.full((1000, steady.id.max() + 1, 2), np.nan)
        people[np.rint(10 * steady.stamp).astype(int), steady.id] = steady.position
        for name, seen in beliefs(tracked, predictor).items():
            rows[name].append(drive(people[BEGIN:], seen))
    tables = {name: np.array(episodes) * [100, 1, 1, 1] for name, episodes in rows.items()}
    *_, straight_on, forecast = tables.values()
    tables["difference of the last two"] = forecast - straight_on
    print("| what the robot believes | collisions, % | least distance, m | way, m | time, s |")
    print("|---|---:|---:|---:|---:|")
    for name, table in tables.items():
        mean, half = table.mean(axis=0), 1.96 * table.std(axis=0, ddof=1) / len(table) ** 0.5
        print(f"| {name} |", " | ".join(f"{m:.2f} ± {h:.2f}" for m, h in zip(mean, half)), "|")


if __name__ == "__main__":
    main()
