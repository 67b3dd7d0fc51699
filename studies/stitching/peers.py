"""What stitching is compared with: greedy constant velocity, and norfair where it is installed."""

import numpy as np

from neurosym_jax.data.tracks import Tracks
from neurosym_robot.tracking.following import frames_of_tracks, velocity
from neurosym_robot.tracking.stitching import LinkOptions

__all__ = ["greedy", "norfair_ids"]


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


def norfair_ids(tracks: Tracks) -> np.ndarray | None:
    """[R] ids of norfair 2, which is given positions without ids, -1 for none; None without it."""
    try:
        from norfair import Detection, Tracker
    except ImportError:
        return None
    tracker = Tracker(
        distance_function="euclidean",
        distance_threshold=1.0,
        hit_counter_max=30,
        initialization_delay=3,
    )
    given = np.full(len(tracks.id), -1)
    rows = {(stamp, id): n for n, (stamp, id) in enumerate(zip(tracks.stamp, tracks.id.tolist()))}
    for frame in frames_of_tracks(tracks):
        here = [
            Detection(points=xy[None], data=rows[frame.stamp, id])
            for id, xy in zip(frame.ids.tolist(), frame.xy)
        ]
        for followed in tracker.update(detections=here):
            newest = followed.last_detection
            if any(newest is each for each in here):
                given[newest.data] = followed.id
    return given
