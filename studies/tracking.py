"""Ids by TrackEval on real tracks as a robot would see them, for trackers of four kinds.

`python -m studies.tracking DATA [SEEDS]` prints the table of docs/predictor.md; DATA holds
SGAN's files of ETH/UCY. Options of the filter were chosen on seed 100; seeds from 0 on are
reported. trackeval and norfair come with `pip install trackeval norfair`.
"""

import dataclasses
import sys
from collections import defaultdict
from pathlib import Path
from typing import Any

import numpy as np
from scipy.optimize import linear_sum_assignment

from neurosym_jax.data.clock import resample
from neurosym_jax.data.recordings import read_any
from neurosym_jax.data.tracks import Tracks
from neurosym_jax.evaluation.intervals import student_half
from neurosym_robot.tracking.kalman import KalmanFilter, LinkOptions

__all__ = ["Labelled", "Sensor", "observe", "table"]

RECORDINGS = {
    "zara1": "crowds_zara01",
    "zara2": "crowds_zara02",
    "hotel": "biwi_hotel",
}
RATE = 10.0
"""Frames a second."""
SECONDS = 120.0
"""Seconds of a recording that are taken."""
RADIUS = 0.3
"""Metres of a body that hides others."""
RANGE = 15.0
"""Metres that the sensor sees."""
GHOST = 0.5
"""Seconds that a false detection lasts on average."""
NEAR, MEMORY = 0.5, 0.3
"""Metres and seconds over which the nearest-neighbour tracker keeps an id."""
MATCH = 1.0
"""Metres between a person and a detection of them at most."""


@dataclasses.dataclass(frozen=True)
class Sensor:
    """What is wrong with detections."""

    noise: float = 0.05
    """Standard deviation of a position along an axis, metres."""
    missed: float = 0.0
    """Probability that a visible person is not detected."""
    ghosts: float = 0.0
    """False detections that begin in a second."""
    view: float = 360.0
    """Degrees that the sensor sees; a narrower one turns to and fro by 60 in 15 s."""
    swaps: float = 0.0
    """Swaps of ids a second between the nearest two people, if they are within a metre."""


SENSORS = {
    "occlusion": Sensor(),
    "10 % missed": Sensor(missed=0.1),
    "30 % missed": Sensor(missed=0.3),
    "15 cm noise": Sensor(noise=0.15),
    "2 ghosts/s": Sensor(ghosts=2.0),
    "view of 100°": Sensor(view=100.0),
    "2 swaps/s": Sensor(swaps=2.0),
}


@dataclasses.dataclass(frozen=True, eq=False)
class Labelled:
    """Detections frame by frame: where, under which id, and the people who can be seen."""

    stamps: np.ndarray  # [F] seconds
    xy: list[np.ndarray]  # [N, 2] metres of each frame
    ids: list[np.ndarray]  # [N] the tracker's ids
    people: list[np.ndarray]  # [M] the people whom the sensor can see
    places: list[np.ndarray]  # [M, 2] metres, where they truly are


def observe(tracks: Tracks, seed: int, sensor: Sensor) -> Labelled:
    """The first minutes of a recording, from a random place at its edge."""
    tracks = resample(tracks, 1 / RATE, 2.0)
    tracks = tracks.take(tracks.stamp < tracks.stamp.min() + SECONDS)
    rng = np.random.default_rng(seed)
    low, high = tracks.position.min(axis=0), tracks.position.max(axis=0)
    robot = rng.uniform(low, high)
    side = rng.integers(2)
    robot[side] = rng.choice([low[side], high[side]])
    ahead = np.arctan2(*((low + high) / 2 - robot)[::-1])
    tracker, ghosts = NearestTracker(), []
    labelled = Labelled(np.unique(tracks.stamp), [], [], [], [])
    for number, stamp in enumerate(labelled.stamps):
        present = tracks.stamp == stamp
        people, places = tracks.id[present], tracks.position[present]
        heading = ahead + np.radians(60) * np.sin(2 * np.pi * number / (15 * RATE))
        seen = is_visible(robot, places, heading, sensor.view)
        people, places = people[seen], places[seen]
        if rng.random() < sensor.ghosts / RATE:
            ghosts.append([rng.geometric(1 / (GHOST * RATE)), rng.uniform(low, high)])
        ghosts = [[left - 1, place] for left, place in ghosts if left > 0]
        detected = rng.random(len(places)) >= sensor.missed
        xy = np.concatenate([places[detected], *[place[None] for _, place in ghosts]])
        xy = xy + rng.normal(0, sensor.noise, xy.shape)
        ids = tracker.push(float(stamp), xy)
        if rng.random() < sensor.swaps / RATE:
            ids = tracker.swap(ids, xy)
        labelled.xy.append(xy)
        labelled.ids.append(ids)
        labelled.people.append(people)
        labelled.places.append(places)
    return labelled


class NearestTracker:
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
        ids, known = np.full(len(xy), -1), list(self._known)
        last = np.array([place for _, place in self._known.values()]).reshape(-1, 2)
        off = np.linalg.norm(xy[:, None] - last, axis=-1).reshape(len(xy), len(last))
        for row, column in zip(*linear_sum_assignment(np.where(off <= NEAR, off, 1e3))):
            if off[row, column] <= NEAR:
                ids[row] = known[column]
        new = ids < 0
        ids[new] = self._next + np.arange(new.sum())
        self._next += int(new.sum())
        self._known |= {id: (stamp, place) for id, place in zip(ids.tolist(), xy)}
        return ids

    def swap(self, ids: np.ndarray, xy: np.ndarray) -> np.ndarray:
        """The ids, those of the nearest two people exchanged from now on."""
        off = np.linalg.norm(xy[:, None] - xy, axis=-1)
        np.fill_diagonal(off, np.inf)
        if not (off < 1.0).any():
            return ids
        one, other = np.unravel_index(off.argmin(), off.shape)
        first, second = int(ids[one]), int(ids[other])
        known = self._known
        known[first], known[second] = known[second], known[first]
        ids = ids.copy()
        ids[one], ids[other] = second, first
        return ids


def is_visible(
    robot: np.ndarray, places: np.ndarray, heading: float, view: float
) -> np.ndarray:
    """[N] bool: whether people at `places` [N, 2] are in view and no nearer person hides them."""
    far = np.linalg.norm(places - robot, axis=1)
    bearing = np.arctan2(*(places - robot).T[::-1])
    angle = np.abs(np.angle(np.exp(1j * (bearing[:, None] - bearing))))
    width = np.arcsin(np.clip(RADIUS / np.maximum(far, RADIUS), 0, 1))
    hidden = (angle < width) & (far < far[:, None] - RADIUS)
    turned = np.abs(np.angle(np.exp(1j * (bearing - heading))))
    in_view = (turned <= np.radians(view / 2)) & (far <= RANGE)
    return in_view & ~hidden.any(axis=1)


def tracker(stream: Labelled) -> list[np.ndarray]:
    """The ids of the nearest-neighbour tracker itself."""
    return stream.ids


def filtered(stream: Labelled) -> list[np.ndarray]:
    """The numbers that the filter of `--stitch` gives; people without ids have them, too."""
    kalman = KalmanFilter()
    return [kalman.push(*row) for row in zip(stream.stamps.tolist(), stream.xy)]


def norfair(stream: Labelled) -> list[np.ndarray]:
    """The ids of norfair's Kalman tracker, as patient as `--stitch`; -1 without one."""
    from norfair import Detection, Tracker

    patience = round(RATE * LinkOptions().max_gap)
    model = Tracker(
        "mean_euclidean", 0.6, hit_counter_max=patience, initialization_delay=0
    )
    ids = []
    for xy in stream.xy:
        detections = [Detection(point[None]) for point in xy]
        objects = model.update(detections)
        names = {id(thing.last_detection): thing.id for thing in objects}
        ids.append(np.array([names.get(id(row), -1) for row in detections], np.int64))
    return ids


METHODS = {
    "tracker": tracker,
    "norfair": norfair,
    "filter (`--stitch`)": filtered,
}


def hota_and_idf1(stream: Labelled, ids: list[np.ndarray]) -> tuple[float, float]:
    """HOTA and IDF1 of detections under `ids`, -1 for none."""
    from trackeval.metrics import HOTA, Identity

    data: dict[str, Any] = {"gt_ids": stream.people, "tracker_ids": []}
    data["similarity_scores"] = []
    for places, xy, names in zip(stream.places, stream.xy, ids):
        xy, names = xy[names >= 0], names[names >= 0]
        off = np.linalg.norm(places[:, None] - xy, axis=-1)
        similarity = np.clip(1 - off / MATCH, 0, 1).reshape(len(places), len(xy))
        data["tracker_ids"].append(names)
        data["similarity_scores"].append(similarity)
    for kind in ("gt", "tracker"):
        rows = data[f"{kind}_ids"]
        numbers = np.unique(np.concatenate(rows))
        data[f"{kind}_ids"] = [np.searchsorted(numbers, row) for row in rows]
        data[f"num_{kind}_ids"] = len(numbers)
        data[f"num_{kind}_dets"] = sum(map(len, rows))
    hota = HOTA().eval_sequence(data)["HOTA"].mean()
    identity = Identity({"PRINT_CONFIG": False}).eval_sequence(data)["IDF1"]
    return float(hota), float(identity)


def table(folder: Path, seeds: range) -> str:
    """Markdown: HOTA / IDF1 of every method in every cell, means over `seeds`.

    In brackets is half of the 95 % interval of the difference to norfair.
    """
    lines = ["| HOTA / IDF1 | " + " | ".join(METHODS) + " |"]
    lines.append("|---|" + "---|" * len(METHODS))
    for recording, file in RECORDINGS.items():
        (tracks,) = read_any(folder / f"{file}.txt")
        for name, sensor in SENSORS.items():
            scores = defaultdict(list)
            for seed in seeds:
                stream = observe(tracks, seed, sensor)
                for method, follow in METHODS.items():
                    scores[method].append(hota_and_idf1(stream, follow(stream)))
            peer = np.array(scores["norfair"])
            cells = [_text(np.array(scores[method]), peer) for method in METHODS]
            lines.append(f"| {recording}, {name} | " + " | ".join(cells) + " |")
            print(lines[-1], file=sys.stderr, flush=True)
    return "\n".join(lines)


def _text(scores: np.ndarray, peer: np.ndarray) -> str:
    """Such as `.903 / .941 (± .012 / .014)`."""
    means = " / ".join(f"{mean:.3f}" for mean in scores.mean(axis=0))
    if len(scores) < 2 or np.array_equal(scores, peer):
        return means
    halves = (student_half((values).tolist()) for values in (scores - peer).T)
    return f"{means} (± {' / '.join(f'{half:.3f}' for half in halves)})"


if __name__ == "__main__":
    count = int(sys.argv[2]) if len(sys.argv) > 2 else 5
    print(table(Path(sys.argv[1]), range(count)))
