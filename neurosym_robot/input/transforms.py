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
        self.parent, self.static = parent, static
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
            self.doubted, self.poses, self.since = self.poses, [], received
        back = bool(self.doubted) and received - self.since > REORDERED
        if self.doubted and stamp > self.doubted[-1][0]:
            # One that was overtaken has a delay as others had before; after a clock was
            # set back, all have a longer one.
            delays, before = _delays([*self.poses, pose]), _delays(self.doubted)
            shift = 0.6 * (self.doubted[-1][0] - self.poses[0][0])
            back |= min(delays) - min(before) > shift > max(before) - min(before)
            if not back:
                self.poses, self.doubted = (
                    sorted(self.doubted + self.poses, key=itemgetter(0)),
                    [],
                )
        if back:
            self.doubted = []
        place = bisect.bisect_left(self.poses, stamp, key=itemgetter(0))
        same = self.poses[place : place + 1] and self.poses[place][0] == stamp
        self.poses[place : place + bool(same)] = [pose]
        oldest = bisect.bisect_left(
            self.poses, self.poses[-1][0] - KEPT, key=itemgetter(0)
        )
        del self.poses[:oldest]
        return back

    def at(self, frame: str, stamp: float, hold: float) -> np.ndarray:
        """[7] pose at a stamp, linear between two known ones; the newest holds for `hold` s."""
        if self.static:
            return self.poses[0][1]
        begin, end = (self.poses[n][0] if self.poses else math.nan for n in (0, -1))
        if not begin <= stamp <= end + hold:
            text = (
                f"where {frame} lies is known from {begin:.2f} to {end:.2f} s, not at"
            )
            error = LookupError if stamp < begin and not self.doubted else NotYet
            raise error(f"{text} {stamp:.2f}")
        after = bisect.bisect_right(self.poses, stamp, key=itemgetter(0))
        before, first, _ = self.poses[after - 1]
        then, last, _ = self.poses[min(after, len(self.poses) - 1)]
        # q and -q are the same rotation. Between messages a robot turns so little that
        # linear and spherical interpolation agree.
        if first[3:] @ last[3:] < 0:
            last = np.concatenate([last[:3], -last[3:]])
        if then - before > GAP and np.abs(last - first).max() > 0.01:
            raise LookupError(
                f"{frame} moved while /tf was silent from {before:.2f} to {then:.2f}"
            )
        share = (stamp - before) / (then - before) if then > before else 0.0
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
            move, turn = row.transform.translation, row.transform.rotation
            pose = np.array(
                [move.x, move.y, move.z, turn.x, turn.y, turn.z, turn.w], np.float64
            )
            if not (np.isfinite(pose).all() and np.linalg.norm(pose[3:]) > 1e-6):
                continue
            child, parent = (
                row.child_frame_id.strip("/"),
                row.header.frame_id.strip("/"),
            )
            with self._lock:
                edge = self._edges.get(child)
                if edge is None or edge.parent != parent or static or edge.static:
                    edge = self._edges[child] = _Edge(parent, static)
                if edge.add((seconds_of(row.header.stamp), pose, received)):
                    self._forget(edge.since)

    def forget(self, before: float) -> None:
        """Forget all poses that arrived before: the clock of people was set back.

        Those that go on as before are of the former clock for a while, as /tf may come
        late.
        """
        with self._lock:
            for edge in self._edges.values():
                if edge.poses and not edge.static and edge.since < before - LATE:
                    edge.former, edge.poses = (edge.poses[-1][0], before + LATE), []
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
            up, down = self._to_root(source), self._to_root(target)
            common = next((frame for frame in up if frame in down), None)
            if common is None:
                raise NotYet(
                    f"no transform between {source or 'unnamed coordinates'} and {target}"
                )
            up_part, down_part = (
                frames[: frames.index(common)] for frames in (up, down)
            )
            outward = self._along(down_part, stamp, hold)
            return np.linalg.inv(outward) @ self._along(up_part, stamp, hold)

    def anchor(self, frame: str) -> str | None:
        """The frame that `frame` is to be at rest in; None if /tf does not know it.

        The first on the way to its root whose name REP 105 calls fixed, or else another
        one of its tree, or else the root.
        """
        with self._lock:
            way = self._to_root(frame)
            tree = [
                child for child in self._edges if self._to_root(child)[-1] == way[-1]
            ]
        return next(filter(is_fixed, [*way[1:], *tree]), way[-1]) if tree else None

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
        matrix, step = np.eye(4), np.eye(4)
        for frame in frames:
            edge = self._edges[frame]
            if stamp is None and not edge.poses:
                raise NotYet(f"where {frame} lies is not known yet")
            pose = edge.poses[-1][1] if stamp is None else edge.at(frame, stamp, hold)
            step[:3, :3], step[:3, 3] = rotation_of(pose[3:]), pose[:3]
            matrix = step @ matrix
        return matrix


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
