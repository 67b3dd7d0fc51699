"""IDF1 of stitching in seven situations: `python -m studies.stitching`.

The options' defaults were chosen on seeds 100 to 109 (`--choose`); those reported are seeds 0 to 9.
`pip install norfair motmetrics` adds a peer, and checks IDF1 against motmetrics.
"""

import sys
from collections.abc import Callable

import numpy as np

from neurosym_jax.data.tracks import Tracks
from neurosym_robot.tracking.following import frames_of_tracks
from neurosym_robot.tracking.stitching import (
    NOBODY,
    LinkOptions,
    OnlineStitcher,
    idf1,
    stitched_ids,
)
from studies.stitching.peers import greedy, norfair_ids
from studies.stitching.situations import SITUATIONS

__all__ = ["METHODS", "offline", "online", "table"]


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

METHODS: dict[str, Callable[[Tracks], np.ndarray | None]] = {
    "tracker": lambda tracks: tracks.id,
    "greedy constant velocity": lambda tracks: greedy(tracks, LinkOptions()),
    "greedy, tighter": lambda tracks: greedy(tracks, TIGHTER),
    "norfair": norfair_ids,
    "offline": offline,
    "live": online,
}


def table(seeds: range) -> str:
    """Markdown: mean IDF1 of every method in every situation, and its 95 % interval's half."""
    lines = [f"| | {' | '.join(SITUATIONS)} |", "|---|" + "---|" * len(SITUATIONS)]
    recordings = {name: [make(seed) for seed in seeds] for name, make in SITUATIONS.items()}
    for method, ids_of in METHODS.items():
        cells = []
        for labelled in recordings.values():
            given = [ids_of(tracks) for tracks, _ in labelled]
            scores = [idf1(p, ids) for (_, p), ids in zip(labelled, given) if ids is not None]
            cells.append(_mean(scores) if scores else "–")
        lines.append(f"| {method} | {' | '.join(cells)} |")
    cells = []
    for labelled in recordings.values():
        right = [tracks.take(p >= 0).with_ids(p[p >= 0]) for tracks, p in labelled]
        cells.append(_mean([idf1(tracks.id, online(tracks)) for tracks in right]))
    return "\n".join([*lines, f"| live, of a tracker without faults | {' | '.join(cells)} |"])


def _mean(scores: list[float]) -> str:
    half = 1.96 * np.std(scores, ddof=1) / len(scores) ** 0.5
    return f"{np.mean(scores):.3f} ± {half:.3f}"


def check(seed: int = 0) -> str:
    """How far our IDF1 is from that of motmetrics, over all situations of a seed."""
    try:
        import motmetrics
    except ImportError:
        return "motmetrics is not installed"
    most = 0.0
    for make in SITUATIONS.values():
        tracks, person = make(seed)
        theirs = motmetrics.MOTAccumulator(auto_id=True)
        for stamp in np.unique(tracks.stamp):
            here = tracks.stamp == stamp
            people, ids = person[here], tracks.id[here]
            rows, columns = np.flatnonzero(people >= 0), np.arange(len(ids))
            apart = np.where(rows[:, None] == columns[None], 0.0, np.nan)
            theirs.update(people[people >= 0].tolist(), ids.tolist(), apart)
        score = motmetrics.metrics.create().compute(theirs, metrics=["idf1"])["idf1"].iloc[0]
        most = max(most, abs(float(score) - idf1(person, tracks.id)))
    return f"IDF1 differs from that of motmetrics by at most {most:.1e}"


if __name__ == "__main__":
    print(table(range(100, 110) if "--choose" in sys.argv[1:] else range(10)))
    print("\n" + check())
