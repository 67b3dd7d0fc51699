"""Which new track goes on where a lost one ended: damped extrapolation and an assignment.

A lost person is expected to go on with the last velocity, which fades with the time constant
`tau`: people who vanish soon turn or stop. The same rule serves a whole recording, where the new
track's beginning is extrapolated backwards too, and a live stream, where it is a single point.
"""

import dataclasses

import numpy as np
from scipy.optimize import linear_sum_assignment

from neurosym_jax.errors import InputError

__all__ = ["LinkOptions", "Loose", "assign", "velocity"]

UNLINKED = 1e6
"""Cost of no link, above that of any that is allowed."""


@dataclasses.dataclass(frozen=True)
class LinkOptions:
    """When two tracks may be one person's."""

    max_gap: float = 6.0
    """Seconds between the end of one and the start of the other."""
    tau: float = 0.8
    """Seconds in which a lost person's velocity fades to 1/e."""
    reach: float = 0.5
    """Metres that the start may lie off where it is expected, at once."""
    drift: float = 1.0
    """Metres more for each second of the gap."""
    memory: float = 0.6
    """Seconds at an end or a start from which its velocity is taken."""

    def __post_init__(self):
        """Refuse what is negative or no number."""
        for field in dataclasses.fields(self):
            value = getattr(self, field.name)
            if not 0 <= value < float("inf") or (field.name == "tau" and value == 0):
                raise InputError(f"{field.name} must be positive, not {value}")


@dataclasses.dataclass(frozen=True, eq=False)
class Loose:
    """Loose ends, or loose starts, of L tracks."""

    stamp: np.ndarray
    """[L] seconds."""
    position: np.ndarray
    """[L, 2] metres."""
    velocity: np.ndarray
    """[L, 2] metres per second; NaN where a single point is known."""


def velocity(stamp: np.ndarray, position: np.ndarray) -> np.ndarray:
    """[2] metres per second, least squares through `position [n, 2]`; NaN for a single point."""
    if len(stamp) < 2:
        return np.full(2, np.nan)
    time = stamp - stamp.mean()
    return time @ position / (time @ time)


def assign(ends: Loose, starts: Loose, options: LinkOptions) -> tuple[np.ndarray, np.ndarray]:
    """Links of least cost: indices into `ends` and into `starts`, of the same length.

    Cost is the distance from where the person was expected, over how far off that may be.
    """
    gap = starts.stamp[None] - ends.stamp[:, None]
    allowed = (gap > 0) & (gap <= options.max_gap)
    gap = np.where(allowed, gap, 0.0)
    travel = (options.tau * -np.expm1(-gap / options.tau))[..., None]
    moved = starts.position[None] - ends.position[:, None]
    ahead = np.linalg.norm(moved - travel * np.nan_to_num(ends.velocity)[:, None], axis=-1)
    back = np.linalg.norm(moved - travel * np.nan_to_num(starts.velocity)[None], axis=-1)
    # A start of which the velocity is unknown is no witness.
    unknown = np.isnan(starts.velocity[:, 0])
    back = np.where(unknown[None, :], ahead, back)
    cost = (ahead + back) / 2 / (options.reach + options.drift * gap)
    cost = np.where(allowed & (cost <= 1), cost, UNLINKED)
    end, start = linear_sum_assignment(cost)
    linked = cost[end, start] < UNLINKED
    return end[linked], start[linked]
