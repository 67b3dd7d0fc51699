"""A sliding window over a live stream of people: irregular frames in, the model's own steps out.

The online counterpart of `data.tracks.resample`, with the same grid and the same numbers: a grid
point lies linearly between the two neighbouring observations of a person, at most `max_gap` apart.
A person is known at a grid point once seen at or after it. Time is that of the messages' headers.
"""

import dataclasses
import math

import numpy as np
from numpy.typing import ArrayLike

from neurosym_jax.data.tracks import LATE, SNAP
from neurosym_jax.errors import InputError
from neurosym_robot.tracking.motion import FAR, MAX_SPEED, is_jump

__all__ = ["Health", "Window"]


@dataclasses.dataclass
class Health:
    """Counts of what was wrong with a stream so far."""

    frames: int = 0  # pushed, including those refused
    bad_stamps: int = 0  # frames refused: the stamp is not a usable number
    duplicate_stamps: int = 0  # frames refused: same stamp as the frame before
    backward_stamps: int = 0  # frames refused: older than the newest by less than `reset_after`
    clock_resets: int = 0  # times the clock went back by more, and everything was forgotten
    pauses: int = 0  # gaps between frames longer than `max_gap`
    bad_ids: int = 0  # people refused: the id is not a whole number
    duplicate_ids: int = 0  # people refused: the id is in the frame already
    bad_positions: int = 0  # people refused: a coordinate is not finite
    far_positions: int = 0  # people left out: a coordinate is `far` or beyond
    jumps: int = 0  # people faster than `max_speed`, who begin a new track
    refused: int = 0  # people refused: `max_tracks` are followed already
    forgotten: int = 0  # tracks not seen for `timeout`


class _Track:
    """The last observation of a person, and the grid points that are known."""

    __slots__ = ("first", "last", "place", "run", "stamp", "x", "xy", "y")

    def __init__(self, steps: int):
        self.stamp = self.place = -math.inf  # of the last observation: seconds, grid points
        self.x = self.y = 0.0
        self.xy = [(0.0, 0.0)] * steps  # grid point n is at n % steps
        self.last = -1  # newest grid point known
        self.run = 0  # number of grid points known without a break until then
        self.first = 0  # grid point from which on it may be known


class Window:
    """The last `steps` grid points of everybody; grid point n lies at `start + n * period`."""

    def __init__(
        self,
        steps: int,
        period: float,
        *,
        max_gap: float = 1.0,
        timeout: float = 10.0,
        reset_after: float = 5.0,
        max_tracks: int = 1024,
        hold: float = 0.0,
        far: float = FAR,
        max_speed: float = MAX_SPEED,
    ):
        """An empty window.

        Args:
            steps: grid points kept of each track.
            period: seconds between grid points.
            max_gap: longest gap in seconds between two observations that is bridged.
            timeout: seconds after which a track not seen is forgotten.
            reset_after: a stamp this many seconds older than the newest means a clock set back.
            max_tracks: how many are followed at once; of newcomers the nearest to the focus first.
            hold: seconds for which a person not seen is extrapolated.
            far: metres; people with a coordinate this large are left out.
            max_speed: metres per second; see `tracking.motion.is_jump`.

        Raises:
            InputError: for a length or number that is out of range.
        """
        if not (math.isfinite(period) and period > 2 * SNAP):
            raise InputError(f"period must be more than {2 * SNAP} s, not {period}")
        if not (max_gap >= 0 and timeout > max_gap and reset_after >= 0):
            raise InputError(
                "max_gap and reset_after must not be negative, and timeout must exceed max_gap; "
                f"they are {max_gap}, {reset_after} and {timeout}"
            )
        if not (0 <= hold < timeout and far > 0 and max_speed > 0):
            raise InputError(
                "hold must be shorter than timeout, far and max_speed must be positive; "
                f"they are {hold}, {far} and {max_speed}"
            )
        if steps < 1 or max_tracks < 1:
            raise InputError(f"steps and max_tracks must be positive, not {steps}, {max_tracks}")
        self.steps, self.period, self.max_gap = steps, float(period), max_gap
        self.timeout, self.reset_after, self.max_tracks = timeout, reset_after, max_tracks
        self.hold, self.far, self.max_speed = hold, far, max_speed
        self.health = Health()
        self._clear()

    def _clear(self) -> None:
        self._tracks: dict[int, _Track] = {}
        self.start: float | None = None
        self.stamp = -math.inf
        self.index = -1

    def push(
        self, stamp: float, ids: ArrayLike, xy: ArrayLike, focus: ArrayLike | None = None
    ) -> bool:
        """Take in one frame; return whether it reached a new grid point, which `index` then is.

        Args:
            stamp: seconds, of the message's header.
            ids: [N] whole numbers.
            xy: [N, 2] world metres.
            focus: [2] metres; of too many people, the nearest to it are followed.

        Raises:
            InputError: if the shapes differ; whatever else is wrong is counted in `health`.
        """
        ids, xy = np.asarray(ids), np.asarray(xy, np.float64)
        if ids.ndim != 1 or (len(ids) and xy.shape != (len(ids), 2)):
            raise InputError(f"a frame is ids [N] and xy [N, 2], not {ids.shape} and {xy.shape}")
        self.health.frames += 1
        if not self._accept(float(stamp)):
            return False
        assert self.start is not None
        before = self.index
        place = (self.stamp - self.start) / self.period
        if abs(self.stamp - (self.start + round(place) * self.period)) <= SNAP:
            place = float(round(place))
        self.index = math.floor(place)
        kept = {id: t for id, t in self._tracks.items() if self.stamp - t.stamp <= self.timeout}
        self.health.forgotten += len(self._tracks) - len(kept)
        self._tracks = kept
        if len(ids):
            ids, xy = self._followed(*self._clean(ids, xy), focus)
            for id, (x, y) in zip(ids.tolist(), xy.tolist()):
                self._observe(self._tracks[id], place, x, y)
        return self.index > before

    def complete(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """All people with a window that ends now.

        Returns:
            Ids [N], ascending; positions [N, steps, 2]; and the number [N] of final steps that were
            not seen but extrapolated, at the velocity of the last two seen.
        """
        ids = sorted(id for id, track in self._tracks.items() if self._is_complete(track))
        tracks = [self._tracks[id] for id in ids]
        when = np.arange(self.index + 1 - self.steps, self.index + 1)
        last = np.array([track.last for track in tracks], np.int64)
        ring = np.array([track.xy for track in tracks]).reshape(-1, self.steps, 2)
        positions = ring[:, when % self.steps]
        if (last < self.index).any():
            rows = np.arange(len(ids))
            before, newest = (ring[rows, n % self.steps] for n in (last - 1, last))
            ahead = np.maximum(when - last[:, None], 0)[..., None]
            guess = newest[:, None] + ahead * (newest - before)[:, None]
            positions = np.where(ahead > 0, guess, positions)
        return np.array(ids, np.int64), positions, self.index - last

    def incomplete(self) -> dict[int, str]:
        """Why the others are missing: "unseen" at the newest grid point, or "short" windows."""
        return {
            id: "short" if track.last == self.index else "unseen"
            for id, track in self._tracks.items()
            if not self._is_complete(track)
        }

    def _is_complete(self, track: _Track) -> bool:
        """Whether all steps are known, including those that may be extrapolated."""
        missing = self.index - track.last
        held = self.stamp - track.stamp <= self.hold + SNAP and track.run >= 2
        return (missing == 0 or held) and track.run + missing >= self.steps

    def _accept(self, stamp: float) -> bool:
        """Whether this frame is the next; clears everything if the clock was set back."""
        health = self.health
        if not abs(stamp) < LATE:
            health.bad_stamps += 1
            return False
        if stamp == self.stamp:
            health.duplicate_stamps += 1
            return False
        if stamp < self.stamp:
            if self.stamp - stamp < self.reset_after:
                health.backward_stamps += 1
                return False
            health.clock_resets += 1
            self._clear()
        elif self.start is not None and stamp - self.stamp > self.max_gap + 2 * SNAP:
            health.pauses += 1
        self.start = stamp if self.start is None else self.start
        self.stamp = stamp
        return True

    def _clean(self, ids: np.ndarray, xy: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The people of a frame whose id and position can be used."""
        health = self.health
        if ids.dtype.kind not in "iu":
            if ids.dtype.kind != "f":
                raise InputError(f"ids must be whole numbers, not {ids.dtype}")
            whole = np.isfinite(ids) & (np.abs(ids) <= 2.0**53)
            whole &= ids == np.rint(ids)
            health.bad_ids += int((~whole).sum())
            ids, xy = ids[whole], xy[whole]
        ids = ids.astype(np.int64)
        finite, near = np.isfinite(xy).all(axis=1), (np.abs(xy) < self.far).all(axis=1)
        health.bad_positions += int((~finite).sum())
        health.far_positions += int((finite & ~near).sum())
        ids, xy = ids[near], xy[near]
        unique, first = np.unique(ids, return_index=True)
        health.duplicate_ids += len(ids) - len(unique)
        return unique, xy[first]

    def _followed(
        self, ids: np.ndarray, xy: np.ndarray, focus: ArrayLike | None
    ) -> tuple[np.ndarray, np.ndarray]:
        """The people of a frame who have a track or get a new one."""
        known = np.array([id in self._tracks for id in ids.tolist()], bool)
        new, room = np.flatnonzero(~known), self.max_tracks - len(self._tracks)
        if len(new) > room:
            centre = xy.mean(axis=0) if focus is None else np.asarray(focus, np.float64)
            distance = np.linalg.norm(xy[new] - centre, axis=1)
            self.health.refused += len(new) - room
            new = new[np.argsort(distance, kind="stable")[:room]]
        self._tracks |= {id: _Track(self.steps) for id in ids[new].tolist()}
        known[new] = True
        return ids[known], xy[known]

    def _observe(self, track: _Track, place: float, x: float, y: float) -> None:
        """Set the grid points up to `place` of a person who is seen at (x, y)."""
        assert self.start is not None
        gap = self.stamp - track.stamp
        joined = gap <= self.max_gap + 2 * SNAP
        if joined and is_jump(math.hypot(x - track.x, y - track.y), gap, self.max_speed):
            self.health.jumps += 1
            # The grid point between the two stays unknown, which separates their windows.
            track.first = track.last + 2
            joined = False
        first = math.floor(track.place) + 1 if joined else self.index
        if not joined:
            track.run = 0
        # Older grid points than the window's are not kept.
        for n in range(max(first, self.index - self.steps + 1, track.first), self.index + 1):
            if n == place:
                track.xy[n % self.steps] = x, y
            elif joined:
                weight = (self.start + n * self.period - track.stamp) / gap
                weight = min(max(weight, 0.0), 1.0)
                # In this form a person who stands still stays exactly still, as in `resample`.
                at = track.x + weight * (x - track.x), track.y + weight * (y - track.y)
                track.xy[n % self.steps] = at
            else:
                continue
            track.run = track.run + 1 if track.last == n - 1 else 1
            track.last = n
        track.stamp, track.place, track.x, track.y = self.stamp, place, x, y
