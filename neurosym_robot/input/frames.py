"""Coordinate frames in which people would be misread: that move, are tilted, or are a camera's."""

import numpy as np

from neurosym_robot.input.transforms import Transforms, is_fixed

MOVED, TURNED = 0.1, 0.05  # metres and radians from which on a frame is called moving
LEVEL = np.cos(np.radians(10))  # least cosine between a frame's z axis and the vertical
OWN = ("base", "laser", "lidar", "velodyne", "camera", "footprint", "scan", "optical")
"""In the names of frames that are often carried by a robot."""


class FrameCheck:
    """Watches by /tf where the frame of a stream lies."""

    def __init__(self, transforms: Transforms):
        self._transforms = transforms
        self.rest: dict[str, np.ndarray] = {}
        """[4, 4] where the stream's frame lay first, by the frame in which it should be at rest."""

    def objection(self, frame: str) -> tuple[str, str]:
        """What speaks against coordinates in `frame`: cause and a sentence, empty without one.

        A sentence without a cause is a doubt.
        """
        anchor = self._transforms.anchor(frame)
        option = f"--fixed-frame {'map' if anchor in (None, frame) else anchor} transforms them"
        begin = f"coordinates are in {frame!r}"
        meant = f"{option}, and --fixed-frame {frame} takes them as they are"
        if "optical" in frame.lower():
            return (
                "optical frame",
                f"{begin}, a camera's frame, whose z axis is no vertical; {meant}",
            )
        if anchor in (None, frame) and is_own(frame):
            return "", f"{begin}, and /tf does not say if it moves; {option}"
        if anchor in (None, frame):
            return "", ""
        try:
            matrix = self._transforms.matrix(frame, anchor, None)
        except LookupError:
            return "", ""
        first = self.rest.setdefault(anchor, matrix)
        moved = np.linalg.norm(matrix[:3, 3] - first[:3, 3])
        turned = np.arccos(
            np.clip((np.trace(matrix[:3, :3].T @ first[:3, :3]) - 1) / 2, -1, 1)
        )
        if matrix[2, 2] < LEVEL:
            return (
                "tilted frame",
                f"{begin}, whose z axis is not that of {anchor!r}; {meant}",
            )
        if not is_fixed(frame) and (moved > MOVED or turned > TURNED):
            walk = "standing people would seem to walk"
            return (
                "moving frame",
                f"{begin}, which moves against {anchor!r}: {walk}; {meant}",
            )
        return "", ""


def is_own(frame: str) -> bool:
    """Whether a frame's name is one that a robot often carries."""
    return any(name in frame.lower() for name in OWN)
