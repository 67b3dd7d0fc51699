"""Poses of coordinate frames in each other over time, from the messages of /tf and /tf_static.

The part of ROS's tf2 that a stream of people needs, for ROS 1, ROS 2 and bags.
"""

import bisect
import threading
from operator import itemgetter
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from neurosym_robot.ros.definitions import seconds_of

KEPT = 10.0  # seconds of each frame's past
AHEAD = 0.5  # seconds for which the newest pose still holds


class Transforms:
    """A tree of frames; safe to use from any thread."""

    def __init__(self):
        # By frame: its parent, and by time its poses there, translation and quaternion x y z w [7].
        self._edges: dict[str, tuple[str, list[tuple[float, np.ndarray]]]] = {}
        self._lock = threading.Lock()

    def hear(self, message: Any, static: bool = False) -> None:
        """Take in a `tf2_msgs/TFMessage`; `static` ones, of /tf_static, hold at all times."""
        for each in message.transforms:
            at, turn = each.transform.translation, each.transform.rotation
            pose = np.array([at.x, at.y, at.z, turn.x, turn.y, turn.z, turn.w], np.float64)
            if not (np.isfinite(pose).all() and np.linalg.norm(pose[3:]) > 1e-6):
                continue
            child, parent = each.child_frame_id.strip("/"), each.header.frame_id.strip("/")
            stamp = -np.inf if static else seconds_of(each.header.stamp)
            with self._lock:
                before, poses = self._edges.get(child, ("", []))
                newest = poses[-1][0] if poses else stamp
                if before != parent or static or stamp < newest - KEPT:
                    poses = []  # Another parent, or the clock was set back.
                bisect.insort_left(poses, (stamp, pose), key=itemgetter(0))
                oldest = bisect.bisect_left(poses, poses[-1][0] - KEPT, key=itemgetter(0))
                self._edges[child] = parent, poses[oldest:]

    def matrix(self, source: str, target: str, stamp: float) -> np.ndarray:
        """[4, 4] from coordinates in `source` to those in `target` at `stamp` seconds.

        Raises:
            LookupError: with the reason, if it is not known.
        """
        with self._lock:
            up, down = self._to_root(source), self._to_root(target)
            common = next((frame for frame in up if frame in down), None)
            if common is None:
                raise LookupError(f"no transform between {source} and {target}")
            there, back = (
                self._along(frames[: frames.index(common)], stamp) for frames in (up, down)
            )
        return np.linalg.inv(back) @ there

    def _to_root(self, frame: str) -> list[str]:
        """The frame, its parent, and so on; each once, should they form a circle."""
        frames = [frame]
        while (edge := self._edges.get(frames[-1])) is not None and edge[0] not in frames:
            frames.append(edge[0])
        return frames

    def _along(self, frames: list[str], stamp: float) -> np.ndarray:
        matrix = np.eye(4)
        for frame in frames:
            pose = _pose_at(frame, self._edges[frame][1], stamp)
            step = np.eye(4)
            step[:3, :3], step[:3, 3] = Rotation.from_quat(pose[3:]).as_matrix(), pose[:3]
            matrix = step @ matrix
        return matrix


def _pose_at(frame: str, poses: list[tuple[float, np.ndarray]], stamp: float) -> np.ndarray:
    """[7] pose of a frame in its parent, linear between two of those known."""
    begin, end = poses[0][0], poses[-1][0]
    if not begin <= stamp <= end + AHEAD and begin > -np.inf:
        raise LookupError(
            f"where {frame} lies is known from {begin:.2f} to {end:.2f} s, not at {stamp:.2f}"
        )
    after = bisect.bisect_right(poses, stamp, key=itemgetter(0))
    (before, first), (then, last) = poses[after - 1], poses[min(after, len(poses) - 1)]
    share = (stamp - before) / (then - before) if then > before else 0.0
    # q and -q are the same rotation. Between messages a robot turns so little that linear and
    # spherical interpolation agree.
    if first[3:] @ last[3:] < 0:
        last = np.concatenate([last[:3], -last[3:]])
    return (1 - share) * first + share * last
