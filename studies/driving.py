"""A robot crosses a hall of people, with and without forecasts: `python -m studies.driving`.

The halls have seeds 0 to 199. People do not see the robot, and a 10 Hz tracker with its
losses sees them. Every 0.4 s the robot takes the best of 33 velocities by what it
believes of people: that they stand, go straight on, or do what one of 20 sampled
futures says.
"""

from collections import defaultdict
from pathlib import Path

import numpy as np

from neurosym_jax.data.tracks import Tracks, make_tracks
from neurosym_jax.data.windows import resample
from neurosym_jax.simulation.scenarios import TrackerFaults
from neurosym_robot.online.predictor import Predictor, load_models
from neurosym_robot.online.replay import straight
from neurosym_robot.tracking.following import Frame, frames_of_tracks

__all__ = ["beliefs", "drive", "hall", "main"]

EPISODES, BEGIN, LONGEST = 200, 100, 300  # the last two in frames of 0.1 s
START, GOAL = np.array([0.0, 7.5]), np.array([15.0, 7.5])
PERIOD, EVERY, STEPS = 0.4, 4, 8
CONTACT, KEPT = (
    0.5,
    0.7,
)  # metres between two centres: a collision, and what is planned for
RISK, FADE = (
    2.0,
    0.85,
)  # of a contact, in units of 3.2 m of way; each step later counts less
ANGLES = np.linspace(0, 2 * np.pi, 16, endpoint=False)
WAYS = np.stack([np.cos(ANGLES), np.sin(ANGLES)], axis=1)
VELOCITIES = np.concatenate([np.zeros((1, 2)), 0.5 * WAYS, WAYS])
RATE, SECONDS = 10.0, 60.0
FAULTS = TrackerFaults(dropout=0.01, dropout_seconds=1.0, id_switch=1.0, noise=0.05)
"""A loss of 1 s on average every 10 s and person, each under a new id."""
Labelled = tuple[Tracks, np.ndarray]  # tracks, and [R] the true person of each row
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
        for name, last_two in (
            ("people stand", pair[:, [1, 1]]),
            ("constant velocity", pair),
        ):
            history[name].append((straight(last_two, STEPS)[None], np.ones(1)))
        (model,), forecast = predictor.models, predictor.forecast()
        belief = history["constant velocity"][-1]
        if forecast is not None:
            result = forecast.models[model]
            others = belief[0][:, ~np.isin(ids, forecast.ids)].repeat(
                len(result.samples), axis=0
            )
            belief = (
                np.append(result.samples[:, :, :STEPS], others, axis=1),
                result.weights,
            )
        history[model].append(belief)
    return history


def drive(people: np.ndarray, seen: list[Belief]) -> list[float]:
    """Collision (0 or 1), least distance, way [m] and time [s] of a robot among `people`.

    They are [F, N, 2] metres at 10 Hz, NaN where nobody is.
    """
    robot, least, way = START.copy(), 3.0, 0.0
    for n, (samples, weights) in enumerate(seen):
        places = robot + VELOCITIES[:, None] * PERIOD * np.arange(1, STEPS + 1)[:, None]
        distance = np.linalg.norm(
            places[:, None, None] - samples, axis=-1
        )  # [V, k, N, STEPS]
        touched = (distance < KEPT).any(axis=2) * FADE ** np.arange(STEPS)
        left = np.linalg.norm(places - GOAL, axis=-1).min(axis=1)
        cost = left / (PERIOD * STEPS) + RISK * touched.max(axis=2) @ weights
        velocity = VELOCITIES[np.argmin(cost)]
        for places_now in people[n * EVERY + 1 : (n + 1) * EVERY + 1]:
            robot = robot + velocity / 10
            least = np.nanmin(
                np.linalg.norm(places_now - robot, axis=-1), initial=least
            )
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
    tables = {
        name: np.array(episodes) * [100, 1, 1, 1] for name, episodes in rows.items()
    }
    *_, straight_on, forecast = tables.values()
    tables["difference of the last two"] = forecast - straight_on
    print(
        "| what the robot believes | collisions, % | least distance, m | way, m | time, s |"
    )
    print("|---|---:|---:|---:|---:|")
    for name, table in tables.items():
        mean, half = (
            table.mean(axis=0),
            1.96 * table.std(axis=0, ddof=1) / len(table) ** 0.5,
        )
        print(
            f"| {name} |",
            " | ".join(f"{m:.2f} ± {h:.2f}" for m, h in zip(mean, half)),
            "|",
        )


def hall(seed: int) -> Labelled:
    """People who cross a hall of 15 m x 15 m from side to side, by one place where some stop."""
    rng = np.random.default_rng([seed, 2])
    ways = []
    for start in _arrivals(rng, 0.4):
        sides = rng.choice(4, 2, replace=False)
        first, last = (_on_side(side, rng.uniform(1, 14)) for side in sides)
        pause = rng.uniform(1, 5) if rng.random() < 0.4 else 0.0
        ways.append(
            (start, [first, rng.uniform(4, 11, 2), last], rng.uniform(0.9, 1.5), pause)
        )
    return _seen(rng, ways)


def _arrivals(rng: np.random.Generator, rate: float) -> np.ndarray:
    return np.sort(rng.uniform(0, SECONDS, rng.poisson(rate * SECONDS)))


def _on_side(side: int, along: float) -> list[float]:
    return [[0.0, along], [15.0, along], [along, 0.0], [along, 15.0]][side]


def _seen(rng: np.random.Generator, ways: list) -> Labelled:
    """What a tracker with `FAULTS` says of people who walk their ways, one after the other."""
    people = [_walk(rng, *way) for way in ways]
    stamps, persons, places, ids = [], [], [], []
    fresh = len(people)
    for person, (stamp, path) in enumerate(people):
        id, lost_until = person, -1
        for n in range(len(stamp)):
            if n >= lost_until and rng.random() < FAULTS.dropout:
                lost_until = n + rng.geometric(1 / (FAULTS.dropout_seconds * RATE))
                id, fresh = fresh, fresh + 1
            if n >= lost_until:
                stamps.append(stamp[n])
                persons.append(person)
                places.append(path[n] + rng.normal(0, FAULTS.noise, 2))
                ids.append(id)
    return _labelled(
        np.array(stamps), np.array(ids), np.array(places), np.array(persons)
    )


def _walk(
    rng, start: float, goals, speed: float, pause: float
) -> tuple[np.ndarray, np.ndarray]:
    """Stamps [F] and path [F, 2] from the first goal to the last, with a pause in between."""
    goals = [np.asarray(goal, float) for goal in goals]
    place, heading = goals[0].copy(), np.arctan2(*(goals[1] - goals[0])[::-1])
    first = int(np.ceil(start * RATE))
    path, wobble, wait = [], 0.0, 0
    goal = 1
    for _ in range(first, int(SECONDS * RATE) + 1):
        path.append(place.copy())
        if wait:
            wait -= 1
            continue
        way = goals[goal] - place
        if np.hypot(*way) < 0.3:
            goal += 1
            if goal == len(goals):
                break
            wait = round(pause * RATE)
            continue
        error = np.arctan2(way[1], way[0]) - heading
        turn = 2.5 / RATE
        heading += np.clip(np.arctan2(np.sin(error), np.cos(error)), -turn, turn)
        wobble += (
            -wobble / (1.5 * RATE) + 0.1 * np.sqrt(2 / (1.5 * RATE)) * rng.normal()
        )
        pace = speed * (1 + 0.5 * wobble) / RATE
        place += pace * np.array([np.cos(heading + wobble), np.sin(heading + wobble)])
    return (first + np.arange(len(path))) / RATE, np.array(path).reshape(-1, 2)


def _labelled(stamp, ids, position, person) -> Labelled:
    order = np.lexsort((stamp, ids))
    tracks = make_tracks("simulated", stamp[order], ids[order], position[order])
    return tracks, person[order]


if __name__ == "__main__":
    main()
