"""What a nearest-neighbour tracker on a robot says of real people, with occlusion and ghosts."""

import dataclasses

import numpy as np
from scipy.optimize import linear_sum_assignment

from neurosym_jax.data.tracks import Tracks
from neurosym_jax.data.windows import resample

__all__ = ["Labelled", "seen_from_a_robot"]

RATE = 10.0  # frames a second
SECONDS = 120.0  # of a recording that are taken
RADIUS = 0.3  # metres of a body that hides others
NOISE = 0.05  # metres, standard deviation of a detection
RANGE = 15.0  # metres that the sensor sees
GHOST = 0.5  # seconds that a false detection lasts on average
NEAR, MEMORY = 0.5, 0.3  # metres and seconds over which the tracker keeps an id
MATCH = 1.0  # metres between a person and a detection of them at most


@dataclasses.dataclass(frozen=True, eq=False)
class Labelled:
    """Detections frame by frame: where, under which id, and of whom."""

    stamps: np.ndarray  # [F] seconds
    xy: list[np.ndarray]  # [N, 2] metres of each frame
    ids: list[np.ndarray]  # [N] the tracker's ids
    people: list[np.ndarray]  # [M] the people whom the sensor can see
    places: list[np.ndarray]  # [M, 2] metres, where they truly are


def seen_from_a_robot(tracks: Tracks, seed: int, ghosts: float = 0.0) -> Labelled:
    """The first minutes of a recording, from a random place at its edge; `ghosts` a second."""
    tracks = resample(tracks, 1 / RATE, 2.0)
    tracks = tracks.take(tracks.stamp < tracks.stamp.min() + SECONDS)
    rng = np.random.default_rng(seed)
    low, high = tracks.position.min(axis=0), tracks.position.max(axis=0)
    robot = rng.uniform(low, high)
    side = rng.integers(2)
    robot[side] = rng.choice([low[side], high[side]]) * 1.0
    tracker, false = Tracker(), []
    rows: list[tuple[np.ndarray, ...]] = []
    stamps = np.unique(tracks.stamp)
    for stamp in stamps:
        present = tracks.stamp == stamp
        people, places = tracks.id[present], tracks.position[present]
        visible = is_visible(robot, places)
        people, places = people[visible], places[visible]
        if rng.random() < ghosts / RATE:
            count = rng.geometric(1 / (GHOST * RATE))
            false.append([count, rng.uniform(low, high)])
        false = [[count - 1, place] for count, place in false if count > 0]
        xy = np.concatenate([places, *[place[None] for _, place in false]])
        xy = xy + rng.normal(0, NOISE, xy.shape)
        rows.append((xy, tracker.push(float(stamp), xy), people, places))
    return Labelled(stamps, *map(list, zip(*rows)))


class Tracker:
    """Keeps the id of whoever is nearest to where somebody was a moment ago."""

    def __init__(self):
        self._known: dict[int, tuple[float, np.ndarray]] = {}
        self._next = 0

    def push(self, stamp: float, xy: np.ndarray) -> np.ndarray:
        """[N] ids of detections [N, 2]."""
        self._known = {
            id: (when, place)
            for id, (when, place) in self._known.items()
            if stamp - when <= MEMORY + 1e-6
        }
        ids, stored_ids = np.full(len(xy), -1), list(self._known)
        if stored_ids:
            last = np.array([place for _, place in self._known.values()])
            off = np.linalg.norm(xy[:, None] - last, axis=-1)
            for row, column in zip(
                *linear_sum_assignment(np.where(off <= NEAR, off, 1e3))
            ):
                if off[row, column] <= NEAR:
                    ids[row] = stored_ids[column]
        new = ids < 0
        ids[new] = self._next + np.arange(new.sum())
        self._next += int(new.sum())
        self._known |= {id: (stamp, place) for id, place in zip(ids.tolist(), xy)}
        return ids


def is_visible(robot: np.ndarray, places: np.ndarray) -> np.ndarray:
    """[N] bool: whether people at `places` [N, 2] are in range and no nearer person hides them."""
    far = np.linalg.norm(places - robot, axis=1)
    bearing = np.arctan2(*(places - robot).T[::-1])
    angle = np.abs(np.angle(np.exp(1j * (bearing[:, None] - bearing))))
    width = np.arcsin(np.clip(RADIUS / np.maximum(far, RADIUS), 0, 1))
    hidden = (angle < width) & (far < far[:, None] - RADIUS)
    return (far <= RANGE) & ~hidden.any(axis=1)
