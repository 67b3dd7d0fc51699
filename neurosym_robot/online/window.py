"""The newest observations of everybody, resampled backwards from the newest frame.

The online counterpart of `data.tracks.resample` with a grid that ends at the newest stamp: a step
lies linearly between a person's two neighbouring observations, at most `max_gap` apart. Nothing
later than the newest frame exists here. Time is that of the messages' headers.
"""

import dataclasses
import math

import numpy as np
from numpy.typing import ArrayLike

from neurosym_jax.data.tracks import LATE, SNAP
from neurosym_jax.errors import InputError
from neurosym_robot.tracking.motion import FAR, MAX_SPEED, is_jump

__all__ = ["Health", "Window"]

# Seconds: of observations that come faster, all but the newest are thinned out to this distance.
THIN = 0.02


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


class Window:
    """Observations by track, each in a row of a table that grows up to `max_tracks` rows."""

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
        memory: float = 0.0,
    ):
        """An empty window.

        Args:
            steps: length of the window; its last step is the newest frame.
            period: seconds between steps.
            max_gap: longest gap in seconds between two observations that is bridged.
            timeout: seconds after which a track not seen is forgotten.
            reset_after: a stamp this many seconds older than the newest means a clock set back.
            max_tracks: how many are followed at once; of newcomers the nearest to the focus first.
            hold: seconds for which a person not seen is extrapolated.
            far: metres; people with a coordinate this large are left out.
            max_speed: metres per second; see `tracking.motion.is_jump`.
            memory: seconds of observations kept at least, beside those of the window.

        Raises:
            InputError: for a length or number that is out of range.
        """
        if not (math.isfinite(period) and period > 2 * SNAP):
            raise InputError(f"period must be more than {2 * SNAP} s, not {period}")
        if not (0 <= max_gap < timeout and 0 <= hold < timeout and reset_after >= 0):
            raise InputError(
                "max_gap and hold must be shorter than timeout, and nothing negative; they are "
                f"{max_gap}, {hold}, {timeout}, and reset_after {reset_after}"
            )
        if not (far > 0 and max_speed > 0):
            raise InputError(f"far and max_speed must be positive, not {far} and {max_speed}")
        if steps < 1 or max_tracks < 1:
            raise InputError(f"steps and max_tracks must be positive, not {steps}, {max_tracks}")
        self.steps, self.period, self.max_gap = steps, float(period), max_gap
        self.timeout, self.reset_after, self.max_tracks = timeout, reset_after, max_tracks
        self.hold, self.far, self.max_speed = hold, far, max_speed
        self.health = Health()
        seconds = max(steps * period + hold, memory) + max_gap
        self._length = 2 * math.ceil(seconds / THIN) + 4  # half of it is kept when a row is full
        self._clear()

    def _clear(self) -> None:
        self._rows: dict[int, int] = {}
        self._free: list[int] = []
        self._stamps = np.full((0, 0), np.inf)  # [rows, length], ascending, then infinity
        self._places = np.zeros((0, 0, 2))
        self._count = np.zeros(0, np.int64)  # [rows]
        self.stamp = -math.inf
        """Of the newest frame."""

    @property
    def index(self) -> int:
        """Number of the newest step since time 0, which the noise of a forecast depends on."""
        return round(self.stamp / self.period)

    def push(
        self, stamp: float, ids: ArrayLike, xy: ArrayLike, focus: ArrayLike | None = None
    ) -> bool:
        """Take in one frame; return whether it was accepted.

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
        for id, last in zip(list(self._rows), self._last(self._all_rows()).tolist()):
            if self.stamp - last > self.timeout:
                self._free.append(self._rows.pop(id))
                self.health.forgotten += 1
        if len(ids):
            self._observe(*self._followed(*self._clean(ids, xy), focus))
        return True

    def complete(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """All people with a whole window that ends at the newest frame.

        Returns:
            Ids [N], ascending; positions [N, steps, 2]; and the number [N] of final steps that were
            not seen but extrapolated, at the velocity of the last `period` seen.
        """
        ids = np.array(sorted(self._rows), np.int64)
        rows = np.array([self._rows[id] for id in ids.tolist()], np.int64)
        last = self._last(rows)
        held = self.stamp - last <= self.hold + SNAP
        ids, rows, last = ids[held], rows[held], last[held]
        times = self.stamp - self.period * np.arange(self.steps - 1, -1, -1)
        positions = self._at(rows, np.broadcast_to(times, (len(rows), self.steps)))
        ahead = times - last[:, None]
        unseen = ahead > SNAP
        if unseen.any():
            now, before = self._at(rows, last[:, None] - [0.0, self.period]).swapaxes(0, 1)
            speed = (now - before) / self.period
            guess = now[:, None] + ahead[..., None] * speed[:, None]
            positions = np.where(unseen[..., None], guess, positions)
        whole = np.isfinite(positions).all(axis=(1, 2))
        return ids[whole], positions[whole], unseen[whole].sum(axis=1)

    def incomplete(self, ids: np.ndarray) -> dict[int, str]:
        """Why others than `ids` are missing: "unseen" in the newest frame, or "short" windows."""
        last = dict(zip(self._rows, self._last(self._all_rows()).tolist()))
        missing = last.keys() - set(ids.tolist())
        return {id: "short" if last[id] == self.stamp else "unseen" for id in sorted(missing)}

    def resampled(self, ids: ArrayLike, times: ArrayLike) -> np.ndarray:
        """[N, T, 2] where people were at `times` [T], NaN where that is not known."""
        rows = [self._rows.get(id, -1) for id in np.asarray(ids).tolist()]
        known = np.array([row >= 0 for row in rows], bool)
        there = np.array(rows, np.int64)[known]
        times = np.asarray(times, np.float64)
        found = np.full((len(rows), len(times), 2), np.nan)
        found[known] = self._at(there, np.broadcast_to(times, (len(there), len(times))))
        return found

    def _all_rows(self) -> np.ndarray:
        return np.fromiter(self._rows.values(), np.int64, len(self._rows))

    def _last(self, rows: np.ndarray) -> np.ndarray:
        """[N] stamps of the newest observations."""
        return self._stamps[rows, self._count[rows] - 1]

    def _at(self, rows: np.ndarray, times: np.ndarray) -> np.ndarray:
        """[N, T, 2] positions of rows [N] at `times` [N, T]."""
        if not len(rows):
            return np.zeros((0, times.shape[1], 2))
        most = int(self._count[rows].max())
        stamps = self._stamps[rows, :most]
        # Index of the last observation at that time or before.
        before = np.stack([(stamps <= t[:, None] + SNAP).sum(axis=1) for t in times.T], 1) - 1
        after = np.minimum(before + 1, most - 1)
        each = np.arange(len(rows))[:, None]
        since = times - stamps[each, before]
        exact = np.abs(since) <= SNAP
        gap = stamps[each, after] - stamps[each, before]
        known = (before >= 0) & (exact | ((gap > 0) & (gap <= self.max_gap + 2 * SNAP)))
        weight = np.divide(since, gap, out=np.zeros_like(since), where=known & ~exact)[..., None]
        first = self._places[rows[:, None], before]
        # In this form a person who stands still stays exactly still, as in `resample`.
        found = first + weight * (self._places[rows[:, None], after] - first)
        return np.where(known[..., None], found, np.nan)

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
        elif stamp - self.stamp > self.max_gap + 2 * SNAP and math.isfinite(self.stamp):
            health.pauses += 1
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
        """Rows, new ones among them, and positions of the people of a frame who are followed."""
        known = np.array([id in self._rows for id in ids.tolist()], bool)
        new, room = np.flatnonzero(~known), self.max_tracks - len(self._rows)
        if len(new) > room:
            centre = xy.mean(axis=0) if focus is None else np.asarray(focus, np.float64)
            distance = np.linalg.norm(xy[new] - centre, axis=1)
            self.health.refused += len(new) - room
            new = new[np.argsort(distance, kind="stable")[:room]]
        for id in ids[new].tolist():
            if not self._free:
                self._grow()
            self._rows[id] = row = self._free.pop()
            self._count[row], self._stamps[row] = 0, np.inf
        known[new] = True
        return np.array([self._rows[id] for id in ids[known].tolist()], np.int64), xy[known]

    def _grow(self) -> None:
        """Twice as many rows."""
        rows = len(self._count)
        more = max(16, rows)
        self._stamps = np.concatenate(
            [self._stamps.reshape(rows, self._length), np.full((more, self._length), np.inf)]
        )
        places = self._places.reshape(rows, self._length, 2)
        self._places = np.concatenate([places, np.zeros((more, self._length, 2))])
        self._count = np.concatenate([self._count, np.zeros(more, np.int64)])
        self._free += range(rows, rows + more)

    def _observe(self, rows: np.ndarray, xy: np.ndarray) -> None:
        """Append an observation to each row."""
        each = np.arange(len(rows))
        count = self._count[rows]
        last = np.where(count > 0, self._stamps[rows, count - 1], -LATE)
        gap = self.stamp - last
        moved = np.linalg.norm(xy - self._places[rows, count - 1], axis=1)
        jumped = (count > 0) & (gap <= self.max_gap + 2 * SNAP)
        jumped &= is_jump(moved, gap, self.max_speed)
        self.health.jumps += int(jumped.sum())
        count[jumped] = 0
        # Of three observations within THIN the middle one is replaced.
        before = np.where(count > 1, self._stamps[rows, count - 2], -LATE)
        count -= (count > 1) & (last - before < THIN)
        full = each[count == self._length]
        half = self._length // 2
        self._stamps[rows[full], :half] = self._stamps[rows[full], -half:]
        self._places[rows[full], :half] = self._places[rows[full], -half:]
        count[full] = half
        self._stamps[rows, count], self._places[rows, count] = self.stamp, xy
        self._count[rows] = count + 1
        # What is left beyond the newest is not an observation.
        for row, begin in zip(rows[full].tolist(), count[full].tolist()):
            self._stamps[row, begin + 1 :] = np.inf
        self._stamps[rows[jumped], 1:] = np.inf
