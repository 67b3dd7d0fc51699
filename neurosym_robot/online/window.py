"""A sliding window over a live stream of people: irregular frames in, the model's own steps out.

Online counterpart of `data.tracks.resample`, with the same grid and the same numbers: a grid point
lies linearly between the two neighbouring observations of a person, at most `max_gap` apart.
A person is known at a grid point once seen at or after it; where that is wanted, somebody who was
lost a moment ago is extrapolated meanwhile, which is said and never remembered. All storage is
allocated at the start. It knows stamps in the messages' headers, never the wall clock.
"""

import dataclasses

import numpy as np
from numpy.typing import ArrayLike

from neurosym_jax.data.tracks import LATE, SNAP
from neurosym_jax.errors import InputError
from neurosym_robot.tracking.motion import FAR, MAX_SPEED, is_jump

__all__ = ["Health", "Window"]


@dataclasses.dataclass
class Health:
    """What was wrong with a stream so far; every field is a count."""

    frames: int = 0  # frames pushed, those refused included
    bad_stamps: int = 0  # frames refused: the stamp is no usable number
    duplicate_stamps: int = 0  # frames refused: the stamp of the frame before
    # Frames refused: older than the newest frame, by less than `reset_after`.
    backward_stamps: int = 0
    # The clock went back by more: everything was forgotten, the grid begins anew.
    clock_resets: int = 0
    # Nothing was heard for longer than `max_gap`, a jump of the clock ahead included.
    pauses: int = 0
    bad_ids: int = 0  # people refused: the id is not a whole number
    duplicate_ids: int = 0  # people refused: the id is in the frame already
    bad_positions: int = 0  # people refused: a coordinate is not finite
    # People left out: a coordinate is `far` or beyond, where trackers put those they lost.
    far_positions: int = 0
    jumps: int = 0  # people who moved farther than anybody walks: somebody new begins there
    refused: int = 0  # people refused: `max_tracks` are followed already
    forgotten: int = 0  # tracks forgotten: not seen for `timeout`


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
        """An empty window; lengths in seconds.

        Args:
            steps: grid points kept of each track.
            period: between grid points.
            max_gap: the longest gap between two observations that is bridged.
            timeout: a track not seen for so long is forgotten.
            reset_after: a stamp this much older than the newest means that the clock was set back.
            max_tracks: how many are followed at once; of newcomers the nearest to the focus first.
            hold: somebody not seen for up to so long is extrapolated.
            far: metres; who has a coordinate that is as large is left out.
            max_speed: metres per second; see `tracking.motion.is_jump`.

        Raises:
            InputError: for a length or number that is out of range.
        """
        if not (np.isfinite(period) and period > 2 * SNAP):
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
        self.steps, self.period = steps, float(period)
        self.max_gap, self.timeout, self.reset_after = max_gap, timeout, reset_after
        self.hold, self.far, self.max_speed = hold, far, max_speed
        self.health = Health()
        self._id = np.zeros(max_tracks, np.int64)
        self._stamp = np.full(max_tracks, -np.inf)
        self._place = np.zeros(max_tracks)  # of the last observation, in grid points
        self._position = np.zeros((max_tracks, 2))
        self._ring = np.zeros((max_tracks, steps, 2))
        self._last = np.full(max_tracks, -1, np.int64)  # newest grid point known
        self._run = np.zeros(max_tracks, np.int64)  # grid points known without a break until then
        self._first = np.zeros(max_tracks, np.int64)  # grid point from which on it may be known
        self._clear()

    def _clear(self) -> None:
        self._slot: dict[int, int] = {}
        self._free = list(range(len(self._id) - 1, -1, -1))
        self._run[:] = 0
        self.start: float | None = None
        self.stamp = -np.inf
        self.index = -1

    def push(
        self, stamp: float, ids: ArrayLike, xy: ArrayLike, focus: ArrayLike | None = None
    ) -> bool:
        """Take in one frame; whether it reached a new grid point, which `index` then is.

        Args:
            stamp: seconds, of the message's header.
            ids: [N] whole numbers.
            xy: [N, 2] world metres.
            focus: [2] metres; decides who is followed when there are too many.

        Raises:
            InputError: where the shapes differ; whatever else is wrong is counted in `health`.
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
        self.index = int(np.floor(place))
        self._forget()
        if len(ids):
            self._observe(place, *self._clean(ids, xy), focus)
        return self.index > before

    def complete(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """All with a window that ends now.

        Returns:
            Ids [N], ascending; positions [N, steps, 2]; and the number [N] of steps at the end that
            were not seen but extrapolated, at the velocity of the last two that were.
        """
        slots = np.array(sorted(self._slot.values()), int)
        slots = slots[self._is_complete(slots)]
        slots = slots[np.argsort(self._id[slots], kind="stable")]
        last = self._last[slots]
        when = np.arange(self.index + 1 - self.steps, self.index + 1)
        positions = self._ring[slots][:, when % self.steps]
        if (last < self.index).any():
            before, newest = (self._ring[slots, n % self.steps] for n in (last - 1, last))
            ahead = np.maximum(when - last[:, None], 0)[..., None]
            guess = newest[:, None] + ahead * (newest - before)[:, None]
            positions = np.where(ahead > 0, guess, positions)
        return self._id[slots], positions, self.index - last

    def incomplete(self) -> dict[int, str]:
        """Why the others are missing: "unseen" at the newest grid point, or "short" windows."""
        slots = np.array(list(self._slot.values()), int)
        out = slots[~self._is_complete(slots)]
        reasons = np.where(self._last[out] == self.index, "short", "unseen")
        return dict(zip(self._id[out].tolist(), reasons.tolist()))

    def _is_complete(self, slots: np.ndarray) -> np.ndarray:
        """[S] whether each has all its steps, those that may be extrapolated included."""
        missing = self.index - self._last[slots]
        held = (self.stamp - self._stamp[slots] <= self.hold + SNAP) & (self._run[slots] >= 2)
        return ((missing == 0) | held) & (self._run[slots] + missing >= self.steps)

    def _accept(self, stamp: float) -> bool:
        """Whether this frame is the next; clears everything where the clock was set back."""
        health = self.health
        if not abs(stamp) < LATE:
            health.bad_stamps += 1
            return False
        if stamp <= self.stamp:
            if stamp == self.stamp:
                health.duplicate_stamps += 1
                return False
            if self.stamp - stamp < self.reset_after:
                health.backward_stamps += 1
                return False
            health.clock_resets += 1
            self._clear()
        elif stamp - self.stamp > self.max_gap + 2 * SNAP and self.start is not None:
            health.pauses += 1
        if self.start is None:
            self.start = stamp
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
        fine, near = np.isfinite(xy).all(axis=1), (np.abs(xy) < self.far).all(axis=1)
        health.bad_positions += int((~fine).sum())
        health.far_positions += int((fine & ~near).sum())
        ids, xy = ids[near], xy[near]
        unique, first = np.unique(ids, return_index=True)
        health.duplicate_ids += len(ids) - len(unique)
        return unique, xy[first]

    def _forget(self) -> None:
        slots = np.array(list(self._slot.values()), int)
        for slot in slots[self.stamp - self._stamp[slots] > self.timeout].tolist():
            del self._slot[int(self._id[slot])]
            self._free.append(slot)
            self.health.forgotten += 1

    def _enter(self, ids: np.ndarray, xy: np.ndarray, focus: ArrayLike | None) -> None:
        """Slots for those who have none yet."""
        new = np.array([n for n, id in enumerate(ids.tolist()) if id not in self._slot], int)
        if len(new) > len(self._free):
            centre = xy.mean(axis=0) if focus is None else np.asarray(focus, np.float64)
            distance = np.linalg.norm(xy[new] - centre, axis=1)
            new = new[np.argsort(distance, kind="stable")]
            self.health.refused += len(new) - len(self._free)
            new = new[: len(self._free)]
        for id in ids[new].tolist():
            slot = self._free.pop()
            self._slot[id] = slot
            self._id[slot], self._stamp[slot] = id, -np.inf
            self._run[slot], self._last[slot], self._first[slot] = 0, -1, 0

    def _observe(
        self, place: float, ids: np.ndarray, xy: np.ndarray, focus: ArrayLike | None
    ) -> None:
        """Grid points up to `place` of everybody in this frame."""
        assert self.start is not None
        self._enter(ids, xy, focus)
        slots = np.array([self._slot.get(id, -1) for id in ids.tolist()], int)
        xy, slots = xy[slots >= 0], slots[slots >= 0]
        stamp, position = self._stamp[slots], self._position[slots]
        joined = self.stamp - stamp <= self.max_gap + 2 * SNAP
        moved = np.linalg.norm(xy - position, axis=1)
        jumped = joined & is_jump(moved, self.stamp - stamp, self.max_speed)
        self.health.jumps += int(jumped.sum())
        # A step between the two stays unknown, so that nobody takes them for one.
        self._first[slots[jumped]] = self._last[slots[jumped]] + 2
        joined &= ~jumped
        self._run[slots[~joined]] = 0
        since = np.floor(self._place[slots])
        span = np.where(joined, self.stamp - stamp, 1.0)
        first = since[joined].min() + 1 if joined.any() else self.index
        # Older grid points than a window's have no place in the ring and are not asked for.
        for n in range(int(max(first, self.index - self.steps + 1)), self.index + 1):
            exact = n == place
            fill = ((joined & (since < n)) | exact) & (n >= self._first[slots])
            weight = (self.start + n * self.period - np.where(joined, stamp, 0.0)) / span
            weight = np.clip(weight, 0.0, 1.0)[:, None]
            # In this form a person who stands still stays exactly still, as in `resample`.
            value = xy if exact else position + weight * (xy - position)
            into = slots[fill]
            self._ring[into, n % self.steps] = value[fill]
            follows = self._last[into] == n - 1
            self._run[into] = np.where(follows, self._run[into], 0) + 1
            self._last[into] = n
        self._stamp[slots], self._place[slots], self._position[slots] = self.stamp, place, xy
