"""Where coordinate frames lie in each other over time, as ROS's tf2 knows it from /tf.

A pose is interpolated between two known ones and never extrapolated: until the second
has come, the answer is `NotYet`. When the clock is set back, what was known before is
forgotten.
"""

import bisect
import math
import re
import threading
from collections.abc import Iterable
from operator import itemgetter
from typing import Any

import numpy as np

from neurosym_robot.ros.definitions import seconds_of

KEPT = 10.0  # seconds of each frame's past
GAP = 1.0  # seconds between two poses that differ, over which nothing is interpolated
# seconds for which older poses after newer ones are taken for late ones
REORDERED = 0.15
LATE = 1.0  # seconds by which /tf may come later than people
FIXED = re.compile("map|odom|world|earth")
"""In the names of frames that do not move with a robot, after ROS's REP 105."""

Pose = tuple[float, np.ndarray, float]
"""Stamp [s], translation and quaternion x y z w [7], and time of arrival [s]."""


class NotYet(LookupError):
    """A transform is not known, but may become known."""


class _Edge:
    """Poses of a frame in its parent, by stamp."""

    def __init__(self, parent: str, static: bool):
        self.parent = parent
        self.static = static
        self.poses: list[Pose] = []
        self.doubted: list[Pose] = []
        """Poses from before an older stamp came: the clock was set back, or that one was late."""
        self.since = -math.inf  # when the last of these came
        self.former = (-math.inf, -math.inf)
        """Newest stamp when the clock of people was set back, and arrival until which newer ones
        are of the former clock: /tf comes late."""

    def add(self, pose: Pose) -> bool:
        """Add a pose; return whether the clock was set back."""
        stamp, _, received = pose
        if stamp > self.former[0] and received < self.former[1]:
            return False
        self.former = (-math.inf, -math.inf)
        if not self.doubted and self.poses and stamp < self.poses[-1][0]:
            self.doubted = self.poses
            self.poses = []
            self.since = received
        back = bool(self.doubted) and received - self.since > REORDERED
        if self.doubted and stamp > self.doubted[-1][0]:
            back |= self._is_set_back(pose)
            if not back:
                together = self.doubted + self.poses
                self.poses = sorted(together, key=itemgetter(0))
                self.doubted = []
        if back:
            self.doubted = []
        self._insert(pose)
        return back

    def _is_set_back(self, pose: Pose) -> bool:
        """Whether the clock was set back, by a pose that is newer than those in doubt.

        One that was overtaken has a delay as others had before; after a clock was set
        back, all have a longer one.
        """
        delays = _delays([*self.poses, pose])
        before = _delays(self.doubted)
        shift = 0.6 * (self.doubted[-1][0] - self.poses[0][0])
        return min(delays) - min(before) > shift > max(before) - min(before)

    def _insert(self, pose: Pose) -> None:
        """Put a pose in its place, instead of one of the same stamp, and forget old ones."""
        stamp = pose[0]
        begin = bisect.bisect_left(self.poses, stamp, key=itemgetter(0))
        end = bisect.bisect_right(self.poses, stamp, key=itemgetter(0))
        self.poses[begin:end] = [pose]
        newest = self.poses[-1][0]
        oldest = bisect.bisect_left(self.poses, newest - KEPT, key=itemgetter(0))
        del self.poses[:oldest]

    def at(self, frame: str, stamp: float, hold: float) -> np.ndarray:
        """[7] pose at a stamp, linear between two known ones; the newest holds for `hold` s."""
        if self.static:
            return self.poses[0][1]
        begin = end = math.nan
        if self.poses:
            begin = self.poses[0][0]
            end = self.poses[-1][0]
        if not begin <= stamp <= end + hold:
            span = f"from {begin:.2f} to {end:.2f} s, not at {stamp:.2f}"
            is_over = stamp < begin and not self.doubted
            error = LookupError if is_over else NotYet
            raise error(f"where {frame} lies is known {span}")

        after = bisect.bisect_right(self.poses, stamp, key=itemgetter(0))
        before, first, _ = self.poses[after - 1]
        then, last, _ = self.poses[min(after, len(self.poses) - 1)]
        # q and -q are the same rotation. Between messages a robot turns so little that
        # linear and spherical interpolation agree.
        if first[3:] @ last[3:] < 0:
            last = np.concatenate([last[:3], -last[3:]])
        gap = then - before
        if gap > GAP and np.abs(last - first).max() > 0.01:
            raise LookupError(
                f"{frame} moved while /tf was silent from {before:.2f} to {then:.2f}"
            )
        share = 0.0
        if gap > 0:
            share = (stamp - before) / gap
        return (1 - share) * first + share * last


def _delays(poses: list[Pose]) -> list[float]:
    """Seconds from stamp to arrival of the newest poses."""
    return [received - stamp for stamp, _, received in poses[-10:]]


class Transforms:
    """The tree of coordinate frames; safe to use from any thread."""

    def __init__(self):
        self._edges: dict[str, _Edge] = {}
        self._lock = threading.Lock()

    def hear(self, message: Any, static: bool = False, received: float = 0.0) -> None:
        """Take in a `tf2_msgs/TFMessage`; `static` ones, of /tf_static, hold at all times.

        `received` is the time of arrival in seconds of any monotonic clock.
        """
        for row in message.transforms:
            pose = _pose_of(row.transform)
            if not (np.isfinite(pose).all() and np.linalg.norm(pose[3:]) > 1e-6):
                continue
            child = row.child_frame_id.strip("/")
            parent = row.header.frame_id.strip("/")
            stamp = seconds_of(row.header.stamp)
            with self._lock:
                edge = self._edges.get(child)
                if edge is None or edge.parent != parent or static or edge.static:
                    edge = self._edges[child] = _Edge(parent, static)
                if edge.add((stamp, pose, received)):
                    self._forget(edge.since)

    def forget(self, before: float) -> None:
        """Forget all poses that arrived before: the clock of people was set back.

        Those that go on as before are of the former clock for a while, as /tf may come
        late.
        """
        with self._lock:
            for edge in self._edges.values():
                if edge.poses and not edge.static and edge.since < before - LATE:
                    edge.former = (edge.poses[-1][0], before + LATE)
                    edge.poses = []
            self._forget(before)

    def _forget(self, before: float) -> None:
        for edge in self._edges.values():
            if not edge.static:
                edge.poses = [pose for pose in edge.poses if pose[2] >= before]
                edge.doubted = []

    def matrix(
        self, source: str, target: str, stamp: float | None, hold: float = 0.0
    ) -> np.ndarray:
        """[4, 4] from coordinates in `source` to those in `target` at `stamp` seconds.

        The newest pose holds for `hold` seconds; a stamp of None asks for the newest
        poses.

        Raises:
            NotYet: with the reason, if it is not known, but may become known.
            LookupError: with the reason, if it will not.
        """
        with self._lock:
            up = self._to_root(source)
            down = self._to_root(target)
            common = next((frame for frame in up if frame in down), None)
            if common is None:
                name = source or "unnamed coordinates"
                raise NotYet(f"no transform between {name} and {target}")
            from_source = self._along(up[: up.index(common)], stamp, hold)
            from_target = self._along(down[: down.index(common)], stamp, hold)
            return np.linalg.inv(from_target) @ from_source

    def anchor(self, frame: str) -> str | None:
        """The frame that `frame` is to be at rest in; None if /tf does not know it.

        The first on the way to its root whose name REP 105 calls fixed, or else another
        one of its tree, or else the root.
        """
        with self._lock:
            way = self._to_root(frame)
            root = way[-1]
            tree = [child for child in self._edges if self._to_root(child)[-1] == root]
        if not tree:
            return None
        others = [*way[1:], *tree]
        return next(filter(is_fixed, others), root)

    def _to_root(self, frame: str) -> list[str]:
        """The frame, its parent, and so on; each once, should they form a circle."""
        frames = [frame]
        edge = self._edges.get(frame)
        while edge is not None and edge.parent not in frames:
            frames.append(edge.parent)
            edge = self._edges.get(edge.parent)
        return frames

    def _along(
        self, frames: Iterable[str], stamp: float | None, hold: float
    ) -> np.ndarray:
        matrix = np.eye(4)
        for frame in frames:
            edge = self._edges[frame]
            if stamp is not None:
                pose = edge.at(frame, stamp, hold)
            elif edge.poses:
                pose = edge.poses[-1][1]
            else:
                raise NotYet(f"where {frame} lies is not known yet")
            step = np.eye(4)
            step[:3, :3] = rotation_of(pose[3:])
            step[:3, 3] = pose[:3]
            matrix = step @ matrix
        return matrix


def _pose_of(transform: Any) -> np.ndarray:
    """[7] translation and quaternion x y z w of a `geometry_msgs/Transform`."""
    move = transform.translation
    turn = transform.rotation
    numbers = [move.x, move.y, move.z, turn.x, turn.y, turn.z, turn.w]
    return np.array(numbers, np.float64)


def rotation_of(quaternion: np.ndarray) -> np.ndarray:
    """[3, 3] of a quaternion x, y, z, w of any length but 0."""
    x, y, z, w = quaternion / np.linalg.norm(quaternion)
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )


def is_fixed(frame: str) -> bool:
    """Whether a frame's name says that it does not move with a robot."""
    return FIXED.search(frame.rpartition("/")[2].lower()) is not None
