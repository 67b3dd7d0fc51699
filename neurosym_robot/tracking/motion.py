"""Where people can be, and how far they can go between two observations of a tracker."""

import numpy as np

__all__ = ["FAR", "MAX_SPEED", "is_jump"]

# Metres; the original robot's filter puts people whom it does not see at (-3000, -3000).
FAR = 3000.0
MAX_SPEED = 5.0  # metres per second: people run, but trackers are for those who walk
SLACK = 1.0  # metres that a tracker may be off, both observations together


def is_jump(moved: np.ndarray, gap: np.ndarray, max_speed: float = MAX_SPEED) -> np.ndarray:
    """Whether nobody goes as far in that time, element by element.

    Args:
        moved: [...] metres between two observations.
        gap: [...] seconds between them.
        max_speed: metres per second; infinite where anything may be followed.
    """
    return moved > max_speed * gap + SLACK
