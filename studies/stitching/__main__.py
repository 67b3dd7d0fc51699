"""IDF1 of stitching in seven situations: `python -m studies.stitching [FIRST]`, of forty seeds.

The options' defaults were chosen on seeds 100 to 109; those reported are seeds 0 to 39.
"""

import sys
from collections.abc import Callable

import numpy as np

from neurosym_jax.data.tracks import Tracks
from neurosym_jax.evaluation.intervals import student_half
from neurosym_robot.tracking.following import frames_of_tracks, velocity
from neurosym_robot.tracking.stitching import (
    NOBODY,
    LinkOptions,
    OnlineStitcher,
    stitched_ids,
)
from studies.stitching.scoring import idf1
from studies.stitching.situations import SITUATIONS

__all__ = ["METHODS", "greedy", "offline", "online", "table"]


def offline(tracks: Tracks) -> np.ndarray:
    """[R] ids from `stitch`, -1 for rows without a person."""
    ids = stitched_ids(tracks)[0]
    return np.where(ids == NOBODY, -1, ids)


def online(tracks: Tracks) -> np.ndarray:
    """[R] ids from `OnlineStitcher`, frame by frame, -1 for rows without a person."""
    stitcher, given = OnlineStitcher(), np.zeros(len(tracks.id), np.int64)
    order = np.lexsort((tracks.id, tracks.stamp))
    ids = np.concatenate([stitcher.push(*frame) for frame in frames_of_tracks(tracks)])
    given[order] = np.where(ids == NOBODY, -1, ids)
    return given


TIGHTER = LinkOptions(max_gap=4.0, reach=0.4, drift=0.5)  # the best for greedy at doors

METHODS: dict[str, Callable[[Tracks], np.ndarray]] = {
    "tracker": lambda tracks: tracks.id,
    "greedy constant velocity": lambda tracks: greedy(tracks, LinkOptions()),
    "greedy, tighter": lambda tracks: greedy(tracks, TIGHTER),
    "offline": offline,
    "live": online,
}


def table(seeds: range) -> str:
    """Markdown: mean IDF1 of every method in every situation, and its 95 % interval's half.

    Differences of live and greedy are paired: of the same recordings.
    """
    lines = [f"| | {' | '.join(SITUATIONS)} |", "|---|" + "---|" * len(SITUATIONS)]
    recordings = {name: [make(seed) for seed in seeds] for name, make in SITUATIONS.items()}
    scores = {
        method: np.array(
            [[idf1(p, ids_of(tracks)) for tracks, p in each] for each in recordings.values()]
        )
        for method, ids_of in METHODS.items()
    }
    for peer in ("greedy constant velocity", "greedy, tighter"):
        scores[f"live minus {peer}"] = scores["live"] - scores[peer]
    right = [
        [tracks.take(p >= 0).with_ids(p[p >= 0]) for tracks, p in each]
        for each in recordings.values()
    ]
    scores["live, of a tracker without faults"] = np.array(
        [[idf1(tracks.id, online(tracks)) for tracks in each] for each in right]
    )
    for name, rows in scores.items():
        lines.append(f"| {name} | {' | '.join(map(_mean, rows))} |")
    return "\n".join(lines)


def _mean(scores: np.ndarray) -> str:
    return f"{np.mean(scores):.3f} ± {student_half(scores.tolist()):.3f}"


def greedy(tracks: Tracks, options: LinkOptions) -> np.ndarray:
    """[R] ids: each new track goes on with the lost one that is expected nearest, within the same
    limits as ours; nothing is taken back, and a tracker's ids are believed while they last."""
    ids, first, count = np.unique(tracks.id, return_index=True, return_counts=True)
    name = {int(id): int(id) for id in ids}
    lost: set[int] = set()
    for new in np.argsort(tracks.stamp[first], kind="stable"):
        best = None
        for old in range(len(ids)):
            rows = slice(first[old], first[old] + count[old])
            stamp, position = tracks.stamp[rows], tracks.position[rows]
            gap = tracks.stamp[first[new]] - stamp[-1]
            if old in lost or not 0 < gap <= options.max_gap:
                continue
            near = stamp >= stamp[-1] - options.memory
            speed = np.nan_to_num(velocity(stamp[near], position[near]))
            off = tracks.position[first[new]] - position[-1] - gap * speed
            off = float(np.hypot(*off))
            if off <= options.reach + options.drift * gap and (best is None or off < best[0]):
                best = off, old
        if best is not None:
            name[int(ids[new])] = name[int(ids[best[1]])]
            lost.add(best[1])
    return np.array([name[id] for id in tracks.id.tolist()])


if __name__ == "__main__":
    first = int((*sys.argv, "0")[1])
    print(table(range(first, first + 40)))
