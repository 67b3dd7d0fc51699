"""HOTA and IDF1 of stitching by TrackEval, on real tracks seen from a robot.

`python -m studies.stitching DATA` prints the table of docs/predictor.md; DATA holds
SGAN's files of ETH/UCY. Seeds 0 to 9 are reported. trackeval and norfair come with `pip
install trackeval norfair`.
"""

import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from neurosym_jax.data.recordings import read_any
from neurosym_jax.evaluation.intervals import student_half
from neurosym_robot.tracking.stitching import LinkOptions, OnlineStitcher
from studies.stitching.recordings import MATCH, Labelled, seen_from_a_robot

__all__ = ["METHODS", "hota_and_idf1", "table"]

SCENES = {"zara1": "crowds_zara01", "zara2": "crowds_zara02", "hotel": "biwi_hotel"}
GHOSTS = (0.0, 0.5)  # false detections a second


def tracker(recording: Labelled) -> list[np.ndarray]:
    """The ids of the nearest-neighbour tracker itself."""
    return recording.ids


def greedy(recording: Labelled, options: LinkOptions | None = None) -> list[np.ndarray]:
    """The ids of `--stitch`: greedy linking at constant velocity."""
    stitcher = OnlineStitcher(options)
    rows = zip(recording.stamps, recording.ids, recording.xy)
    return [stitcher.push(float(stamp), ids, xy) for stamp, ids, xy in rows]


def norfair(recording: Labelled) -> list[np.ndarray]:
    """The ids of norfair's Kalman tracker, with as much patience as `--stitch`; -1 without one."""
    from norfair import Detection, Tracker

    patience = round(10 * LinkOptions().max_gap)
    model = Tracker(
        "mean_euclidean", 0.6, hit_counter_max=patience, initialization_delay=0
    )
    ids = []
    for xy in recording.xy:
        detections = [Detection(point[None]) for point in xy]
        objects = model.update(detections)
        names = {id(thing.last_detection): thing.id for thing in objects}
        ids.append(np.array([names.get(id(row), -1) for row in detections], np.int64))
    return ids


METHODS: dict[str, Callable[[Labelled], list[np.ndarray]]] = {
    "tracker": tracker,
    "greedy linking (`--stitch`)": greedy,
    "norfair": norfair,
}


def hota_and_idf1(recording: Labelled, ids: list[np.ndarray]) -> tuple[float, float]:
    """HOTA and IDF1 of detections under `ids`, -1 for none, against the people who can be seen."""
    from trackeval.metrics import HOTA, Identity

    data: dict[str, Any] = {"gt_ids": [], "tracker_ids": [], "similarity_scores": []}
    for people, places, xy, names in zip(
        recording.people, recording.places, recording.xy, ids
    ):
        xy, names = xy[names >= 0], names[names >= 0]
        off = np.linalg.norm(places[:, None] - xy, axis=-1).reshape(
            len(places), len(xy)
        )
        data["gt_ids"].append(people)
        data["tracker_ids"].append(names)
        data["similarity_scores"].append(np.clip(1 - off / MATCH, 0, 1))
    for kind in ("gt", "tracker"):
        rows = data[f"{kind}_ids"]
        numbers = np.unique(np.concatenate(rows))
        data[f"{kind}_ids"] = [np.searchsorted(numbers, row) for row in rows]
        data[f"num_{kind}_ids"], data[f"num_{kind}_dets"] = (
            len(numbers),
            sum(map(len, rows)),
        )
    hota = HOTA().eval_sequence(data)["HOTA"].mean()
    identity = Identity({"PRINT_CONFIG": False}).eval_sequence(data)["IDF1"]
    return float(hota), float(identity)


def table(folder: Path, seeds: range) -> str:
    """Markdown: mean IDF1 / HOTA of every method, and halves of their 95 % intervals."""
    cells = [(scene, ghosts) for scene in SCENES for ghosts in GHOSTS]
    lines = [
        "| IDF1 / HOTA | " + " | ".join(f"{s}, {g:g} ghosts/s" for s, g in cells) + " |"
    ]
    lines.append("|---|" + "---|" * len(cells))
    scores: dict[tuple[str, str, float], list[tuple[float, float]]] = {}
    for scene, ghosts in cells:
        (tracks,) = read_any(folder / f"{SCENES[scene]}.txt")
        for seed in seeds:
            recording = seen_from_a_robot(tracks, seed, ghosts)
            for name, method in METHODS.items():
                score = hota_and_idf1(recording, method(recording))
                scores.setdefault((name, scene, ghosts), []).append(score)
    for name in METHODS:
        row = [np.array(scores[name, *cell]) for cell in cells]
        lines.append(f"| {name} | " + " | ".join(map(_text, row)) + " |")
    return "\n".join(lines)


def _text(scores: np.ndarray) -> str:
    hota, identity = (
        f"{s.mean():.3f} ± {student_half(s.tolist()):.3f}" for s in scores.T
    )
    return f"{identity} / {hota}"


if __name__ == "__main__":
    print(table(Path(sys.argv[1]), range(10)))
