"""Links from lost tracks to new ones: constant velocity and an optimal assignment.

A lost track is extrapolated forward, a new one backward, so that a person who left the area is
expected outside it. One rule serves a recording and a live stream, where little of the new track is
known yet.
"""

import dataclasses

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import linear_sum_assignment

from neurosym_jax.errors import InputError

__all__ = ["UNLINKED", "LinkOptions", "TrackEnds", "assign", "link_costs", "velocity"]

UNLINKED = 1e6  # cost of no link, above that of any allowed one


@dataclasses.dataclass(frozen=True)
class LinkOptions:
    """When two tracks may belong to one person."""

    max_gap: float = 6.0
    """Maximum seconds between the end of one track and the start of the other."""
    reach: float = 0.6
    """Maximum distance in metres of the start from its expected position, for a gap of 0 s."""
    drift: float = 0.8
    """Metres added to --reach for each second of the gap."""
    turn: float = 0.2
    """Metres of distance that count as much as a velocity difference of 1 m/s."""
    memory: float = 1.0
    """Seconds at an end or a start over which its velocity is estimated."""
    least: float = 0.3
    """Minimum duration of a track in seconds; shorter ones are a tracker's ghosts and left out."""

    def __post_init__(self):
        """Refuse negative and infinite values."""
        for field in dataclasses.fields(self):
            value = getattr(self, field.name)
            if not 0 <= value < float("inf"):
                raise InputError(f"{field.name} must not be negative, not {value}")


@dataclasses.dataclass(frozen=True, eq=False)
class TrackEnds:
    """The ends, or the starts, of L tracks."""

    stamp: np.ndarray  # [L] seconds
    position: np.ndarray  # [L, 2] metres
    velocity: np.ndarray  # [L, 2] metres per second; NaN for a single point


def velocity(stamp: np.ndarray, position: np.ndarray) -> np.ndarray:
    """[2] metres per second, least squares through `position [n, 2]`; NaN for a single point."""
    if len(stamp) < 2:
        return np.full(2, np.nan)
    time = stamp - stamp.mean()
    return time @ position / (time @ time)


def link_costs(ends: TrackEnds, starts: TrackEnds, options: LinkOptions) -> np.ndarray:
    """[L, M] the distance from the expected position as a share of the distance allowed.

    `UNLINKED` where a lost track cannot be gone on with.
    """
    gap = starts.stamp[None] - ends.stamp[:, None]
    allowed = (gap > 0) & (gap <= options.max_gap)
    gap = np.where(allowed, gap, 0.0)
    moved = starts.position[None] - ends.position[:, None]
    before, after = np.nan_to_num(ends.velocity)[:, None], np.nan_to_num(starts.velocity)[None]
    ahead = np.linalg.norm(moved - gap[..., None] * before, axis=-1)
    back = np.linalg.norm(moved - gap[..., None] * after, axis=-1)
    turned = options.turn * np.linalg.norm(after - before, axis=-1)
    unknown = np.isnan(starts.velocity[:, 0])[None]
    off = np.where(unknown, ahead, (ahead + back) / 2 + turned)
    cost = off / np.maximum(options.reach + options.drift * gap, 1e-9)
    return np.where(allowed & (cost <= 1), cost, UNLINKED)


def assign(cost: np.ndarray, most: ArrayLike = 1.0) -> tuple[np.ndarray, np.ndarray]:
    """Links of least cost: rows and columns of `cost` [L, M].

    `most`, [] or [M], is the highest cost of a link.
    """
    cost = np.where(cost <= np.asarray(most), cost, UNLINKED)
    end, start = linear_sum_assignment(cost)
    linked = cost[end, start] < UNLINKED
    return end[linked], start[linked]
