"""Limits on where people are and how fast they move between two observations of a tracker."""

from typing import Any

__all__ = ["FAR", "MAX_SPEED", "is_jump"]

FAR = 3000.0  # metres; the original robot's filter puts lost people at (-3000, -3000)
MAX_SPEED = 5.0  # metres per second
SLACK = 1.0  # metres of error of a tracker, both observations together


def is_jump(moved: Any, gap: Any, max_speed: float = MAX_SPEED) -> Any:
    """Whether a person cannot have `moved` [...] metres in `gap` [...] seconds, element by element.

    An infinite `max_speed` allows everything.
    """
    return moved > max_speed * gap + SLACK
