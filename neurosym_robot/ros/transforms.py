"""Poses of coordinate frames in each other over time, from the messages of /tf and /tf_static.

The part of ROS's tf2 that a stream of people needs, for ROS 1, ROS 2 and bags.
"""

import bisect
import threading
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from neurosym_robot.ros.people import seconds_of

__all__ = ["Transforms"]

KEPT = 10.0  # seconds of each frame's past
AHEAD = 0.5  # seconds for which the newest pose still holds


class _Edge:
    """Poses of one frame in its parent, by time."""

    def __init__(self, parent: str):
        self.parent = parent
        self.times: list[float] = []
        self.poses: list[np.ndarray] = []  # [7] translation, quaternion x y z w

    def add(self, stamp: float, pose: np.ndarray) -> None:
        if self.times and stamp < self.times[-1] - KEPT:
            self.times, self.poses = [], []  # The clock was set back.
        place = bisect.bisect_left(self.times, stamp)
        self.times.insert(place, stamp)
        self.poses.insert(place, pose)
        old = bisect.bisect_left(self.times, self.times[-1] - KEPT)
        del self.times[:old], self.poses[:old]

    def at(self, frame: str, stamp: float) -> np.ndarray:
        """[4, 4] from this frame to the parent's, linear between two poses."""
        times = self.times
        if times == [-np.inf]:
            return _matrix(self.poses[0])
        if not times[0] <= stamp <= times[-1] + AHEAD:
            known = f"known from {times[0]:.2f} to {times[-1]:.2f} s, not at {stamp:.2f}"
            raise LookupError(f"where {frame} lies is {known}")
        after = bisect.bisect_left(times, stamp)
        if after == len(times) or times[after] == stamp:
            return _matrix(self.poses[min(after, len(times) - 1)])
        first, last = self.poses[after - 1], self.poses[after]
        share = (stamp - times[after - 1]) / (times[after] - times[after - 1])
        # q and -q are the same rotation. Between messages a robot turns so little that linear and
        # spherical interpolation agree.
        if first[3:] @ last[3:] < 0:
            last = np.concatenate([last[:3], -last[3:]])
        return _matrix((1 - share) * first + share * last)


class Transforms:
    """A tree of frames; safe to use from any thread."""

    def __init__(self):
        self._edges: dict[str, _Edge] = {}
        self._lock = threading.Lock()

    def hear(self, message: Any, static: bool = False) -> None:
        """Take in a `tf2_msgs/TFMessage`; `static` ones, of /tf_static, hold at all times."""
        for each in message.transforms:
            at, turn = each.transform.translation, each.transform.rotation
            pose = np.array([at.x, at.y, at.z, turn.x, turn.y, turn.z, turn.w], np.float64)
            if not (np.isfinite(pose).all() and np.linalg.norm(pose[3:]) > 1e-6):
                continue
            child, parent = each.child_frame_id.strip("/"), each.header.frame_id.strip("/")
            with self._lock:
                edge = self._edges.get(child)
                if edge is None or edge.parent != parent or static:
                    edge = self._edges[child] = _Edge(parent)
                edge.add(-np.inf if static else seconds_of(each.header.stamp), pose)

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
        while (edge := self._edges.get(frames[-1])) is not None and edge.parent not in frames:
            frames.append(edge.parent)
        return frames

    def _along(self, frames: list[str], stamp: float) -> np.ndarray:
        matrix = np.eye(4)
        for frame in frames:
            matrix = self._edges[frame].at(frame, stamp) @ matrix
        return matrix


def _matrix(pose: np.ndarray) -> np.ndarray:
    """[4, 4] of translation and quaternion [7]."""
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = Rotation.from_quat(pose[3:]).as_matrix(), pose[:3]
    return matrix
