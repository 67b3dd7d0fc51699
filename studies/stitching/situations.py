"""Seven situations in which trackers break: who was where, and what a 10 Hz tracker said of it."""

import dataclasses
from collections.abc import Callable

import numpy as np

from neurosym_jax.data.tracks import Tracks, make_tracks
from neurosym_jax.simulation.scenarios import TrackerFaults, simulate_labelled

__all__ = ["SITUATIONS"]

RATE, SECONDS = 10.0, 60.0
FAULTS = TrackerFaults(dropout=0.005, dropout_seconds=1.0, id_switch=1.0)
"""A loss of 1 s on average every 20 s and person, each under a new id."""
OFTEN = dataclasses.replace(FAULTS, dropout=0.01)
LOST = dataclasses.replace(OFTEN, noise=0.05)
"""Faults of the recordings of people who come and go."""
SWAPS = dataclasses.replace(FAULTS, id_swap=0.05)
GHOSTS = (2.0, 0.5)
"""False tracks a second, and seconds that one lasts on average."""

Labelled = tuple[Tracks, np.ndarray]
"""Tracks, and [R] the true person of each row, -1 for false detections."""


def room(seed: int, faults: TrackerFaults = FAULTS) -> Labelled:
    """Four or eight people who stay in a room of 5 m x 8.2 m, walking abreast or across."""
    scenario = "cross-path" if seed % 2 else "all-forward"
    return simulate_labelled(scenario, seed, SECONDS, 4 + 4 * (seed // 2 % 2), faults)


def room_often(seed: int) -> Labelled:
    """The room, with losses twice as often."""
    return room(seed, OFTEN)


def swaps(seed: int) -> Labelled:
    """Six people whose ways cross, and whose ids a tracker exchanges when they are near."""
    return simulate_labelled("cross-path", seed, SECONDS, 6, SWAPS)


def ghosts(seed: int) -> Labelled:
    """The room, with false tracks for a moment at random places."""
    tracks, person = room(seed)
    rng = np.random.default_rng([seed, 3])
    rate, mean = GHOSTS
    stamps, ids, places = [], [], []
    for n in range(rng.poisson(rate * SECONDS)):
        length = rng.geometric(1 / (mean * RATE))
        start = rng.integers(int(SECONDS * RATE) - length)
        stamps.append((start + np.arange(length)) / RATE)
        ids.append(np.full(length, 100_000 + n))
        places.append(rng.uniform([0, 0], [5.0, 8.2]) + rng.normal(0, 0.05, (length, 2)))
    return _labelled(
        np.concatenate([tracks.stamp, *stamps]),
        np.concatenate([tracks.id, *ids]),
        np.concatenate([tracks.position, *places]),
        np.concatenate([person, np.full(sum(map(len, stamps)), -1)]),
    )


def corridor(seed: int) -> Labelled:
    """People who go through a corridor of 20 m x 3 m, in from one end and out at the other."""
    rng = np.random.default_rng([seed, 1])
    ways = []
    for start in _arrivals(rng, 0.3):
        ends = [[0.0, rng.uniform(0.4, 2.6)], [20.0, rng.uniform(0.4, 2.6)]]
        ways.append((start, ends[:: rng.choice([-1, 1])], rng.uniform(1.0, 1.5), 0.0))
    return _seen(rng, ways)


def hall(seed: int) -> Labelled:
    """People who cross a hall of 15 m x 15 m from side to side, by one place where some stop."""
    rng = np.random.default_rng([seed, 2])
    ways = []
    for start in _arrivals(rng, 0.4):
        sides = rng.choice(4, 2, replace=False)
        first, last = (_on_side(side, rng.uniform(1, 14)) for side in sides)
        pause = rng.uniform(1, 5) if rng.random() < 0.4 else 0.0
        ways.append((start, [first, rng.uniform(4, 11, 2), last], rng.uniform(0.9, 1.5), pause))
    return _seen(rng, ways)


def doors(seed: int) -> Labelled:
    """A corridor of 12 m whose ends are doors: all go in and out at the same two places."""
    rng = np.random.default_rng([seed, 5])
    ways = []
    for start in _arrivals(rng, 0.5):
        ends = [[x, 1.5 + rng.normal(0, 0.15)] for x in (0.0, 12.0)]
        ways.append((start, ends[:: rng.choice([-1, 1])], rng.uniform(0.8, 1.5), 0.0))
    return _seen(rng, ways)


SITUATIONS: dict[str, Callable[[int], Labelled]] = {
    "room": room,
    "room often": room_often,
    "hall": hall,
    "corridor": corridor,
    "doors": doors,
    "ghosts": ghosts,
    "swaps": swaps,
}


def _arrivals(rng: np.random.Generator, rate: float) -> np.ndarray:
    return np.sort(rng.uniform(0, SECONDS, rng.poisson(rate * SECONDS)))


def _on_side(side: int, along: float) -> list[float]:
    return [[0.0, along], [15.0, along], [along, 0.0], [along, 15.0]][side]


def _seen(rng: np.random.Generator, ways: list) -> Labelled:
    """What a tracker with `LOST` says of people who walk their ways, one after the other."""
    people = [_walk(rng, *way) for way in ways]
    stamps, persons, places, ids = [], [], [], []
    fresh = len(people)
    for person, (stamp, path) in enumerate(people):
        id, lost_until = person, -1
        for n in range(len(stamp)):
            if n >= lost_until and rng.random() < LOST.dropout:
                lost_until = n + rng.geometric(1 / (LOST.dropout_seconds * RATE))
                id, fresh = fresh, fresh + 1
            if n >= lost_until:
                stamps.append(stamp[n])
                persons.append(person)
                places.append(path[n] + rng.normal(0, LOST.noise, 2))
                ids.append(id)
    return _labelled(np.array(stamps), np.array(ids), np.array(places), np.array(persons))


def _walk(rng, start: float, goals, speed: float, pause: float) -> tuple[np.ndarray, np.ndarray]:
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
        wobble += -wobble / (1.5 * RATE) + 0.1 * np.sqrt(2 / (1.5 * RATE)) * rng.normal()
        pace = speed * (1 + 0.5 * wobble) / RATE
        place += pace * np.array([np.cos(heading + wobble), np.sin(heading + wobble)])
    return (first + np.arange(len(path))) / RATE, np.array(path).reshape(-1, 2)


def _labelled(stamp, ids, position, person) -> Labelled:
    order = np.lexsort((stamp, ids))
    tracks = make_tracks("simulated", stamp[order], ids[order], position[order])
    return tracks, person[order]
