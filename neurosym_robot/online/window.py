"""The newest observations of everybody, resampled backwards from the newest frame.

The online counterpart of `data.resample` with a grid that ends at the newest
stamp: a step lies linearly between a person's two neighbouring observations, at most
`max_gap` apart. Nothing later than the newest frame exists here. Time is that of the
messages' headers.
"""

import collections
import math
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from neurosym_jax.data.tracks import LATE, SNAP
from neurosym_jax.errors import InputError
from neurosym_robot.tracking.following import FAR, RESET, is_jump

HEALTH = {
    "frames": "pushed, including those refused",
    "bad_stamps": "frames refused: the stamp is not a usable number",
    "duplicate_stamps": "frames refused: same stamp as the frame before",
    "backward_stamps": "frames refused: older than the newest, but not the one before",
    "clock_resets": "times two frames in a row were older, or one by 5 s: everything was forgotten",
    "pauses": "gaps between frames longer than `max_gap`",
    "duplicate_ids": "people refused: the id is in the frame already",
    "bad_positions": "people refused: a coordinate is not finite",
    "far_positions": "people left out: a coordinate is 3000 m or beyond",
    "jumps": "people who cannot have moved so, who begin a new track",
    "repaired": "people forecast without their tracking errors, once in each forecast",
    "refused": "people refused: `max_tracks` are followed already",
    "forgotten": "tracks not seen for `timeout`",
}
"""What `Window.health` counts of a stream so far."""


NOISE = 0.05
"""Metres: standard deviation of a tracker's position."""
PACE = 1.0
"""Metres per second: standard deviation of a person's velocity along an axis, before any is
known."""
LEAST = 2
"""Last steps that count as seen: a line through two sightings tells both."""
LINE = 0.8
"""Seconds over which a line is drawn through what was seen."""


class Line(NamedTuple):
    """A straight way at constant velocity, through what was seen of a person for a moment."""

    stamp: float
    place: np.ndarray  # [2] metres, at `stamp`
    velocity: np.ndarray  # [2] metres per second
    doubt: float  # standard deviation of the velocity

    @classmethod
    def through(cls, stamps: np.ndarray, places: np.ndarray) -> "Line":
        """The way through `places [R, 2]`.

        It is the posterior of a constant velocity, with errors of `NOISE` and `PACE` as
        prior: of two frames that are 0.1 s apart two thirds of what they say.
        """
        stamp = stamps.mean()
        place = places.mean(axis=0)
        since = stamps - stamp
        away = places - place
        information = since @ since + (NOISE / PACE) ** 2
        velocity = since @ away / information
        doubt = NOISE / math.sqrt(information)
        return cls(stamp, place, velocity, doubt)

    def at(self, stamp: float) -> np.ndarray:
        """[2] metres."""
        return self.place + (stamp - self.stamp) * self.velocity


def lines_at(stamps: np.ndarray, places: np.ndarray, times: np.ndarray) -> list[Line]:
    """The line of each of `times [T]`, through the frames [R] of `LINE` seconds around it."""
    half = min(LINE, stamps[-1] - stamps[0]) / 2
    middles = np.clip(times, stamps[0] + half, stamps[-1] - half)
    unique, index = np.unique(middles, return_inverse=True)
    lines = []
    for middle in unique:
        near = np.abs(stamps - middle) <= half + SNAP
        lines.append(Line.through(stamps[near], places[near]))
    return [lines[n] for n in index]


class Observed(NamedTuple):
    """Windows of N people that end at the newest frame."""

    ids: np.ndarray
    """[N] int64, ascending."""
    positions: np.ndarray
    """[N, steps, 2] metres."""
    extrapolated: np.ndarray
    """[N] number of final steps that were not seen: the last velocity went on."""
    seen: np.ndarray
    """[N] seconds from the first sighting to the last; of a whole window its length. Before the
    first sighting is a line through what was seen."""
    doubt: np.ndarray
    """[N] standard deviation of such a line's velocity, m/s; 0 for windows seen as a whole."""
    sighted: np.ndarray
    """[N, steps] bool, False before the first sighting; the last two count as seen."""

    def take(self, rows: np.ndarray) -> "Observed":
        """The people of these rows."""
        return Observed(*(values[rows] for values in self))


class Window:
    """A table of the newest frames [F] and the people in them [P]."""

    def __init__(
        self,
        steps: int,
        period: float,
        *,
        max_gap: float = 1.0,
        timeout: float = 10.0,
        max_tracks: int = 1024,
        hold: float = 0.0,
        memory: float = 0.0,
        min_seen: float = math.inf,
    ):
        """An empty window of `steps`, `period` seconds apart; the last is the newest frame.

        In seconds, `max_gap` is the longest gap between two observations that is
        bridged, `timeout` the absence after which a track is forgotten, `hold` the
        absence for which a person is extrapolated, and `memory` the past kept at least,
        beside the window. Who was seen for `min_seen` at least has a window, and twice;
        by default who was seen in all of it. Beyond `max_tracks`, those newcomers nearest to the focus are
        followed. InputError for a number out of range.
        """
        if not 2 * SNAP < period < math.inf:
            raise InputError(f"period must be more than {2 * SNAP} s, not {period}")
        if not (0 <= max_gap < timeout and 0 <= hold < timeout):
            raise InputError(
                "max_gap and hold must be shorter than timeout, and not negative; they are "
                f"{max_gap}, {hold} and {timeout}"
            )
        self.steps = steps
        self.period = float(period)
        self.max_gap = max_gap
        self.timeout = timeout
        self.max_tracks = max_tracks
        self.min_seen = min_seen
        self.hold = hold
        self.health = collections.Counter(dict.fromkeys(HEALTH, 0))
        past = max(steps * period + hold, memory)
        self._kept = timeout + past + max_gap
        self._clear()

    def _clear(self) -> None:
        self._ids = np.zeros(0, np.int64)  # [P], ascending
        self._last = np.zeros(0)  # [P] stamps of their newest observations
        self._velocity = np.zeros((0, 2))  # [P, 2] between the last two, NaN of one
        self._stamps = np.full(1, -np.inf)  # [F], ascending
        self._places = np.zeros((1, 0, 2))  # [F, P, 2], NaN where a person was not seen
        self._behind = False  # whether the frame before was refused as an older one
        self.stamp = -math.inf
        """Stamp of the newest frame."""

    @property
    def index(self) -> int:
        """Number of the newest step since time 0, which the noise of a forecast depends on."""
        return round(self.stamp / self.period)

    def push(
        self,
        stamp: float,
        ids: ArrayLike,
        xy: ArrayLike,
        focus: ArrayLike | None = None,
    ) -> bool:
        """Take in one frame, see `Predictor.push`; return whether it was accepted.

        Raises:
            InputError: for other shapes or ids; whatever else is wrong is counted in
                `health`.
        """
        ids = np.asarray(ids)
        xy = np.asarray(xy, np.float64)
        if ids.ndim != 1 or (len(ids) and xy.shape != (len(ids), 2)):
            raise InputError(
                f"a frame is ids [N] and xy [N, 2], not {ids.shape} and {xy.shape}"
            )
        if len(ids) and ids.dtype.kind not in "iu":
            raise InputError(f"ids must be whole numbers, not {ids.dtype}")
        self.health["frames"] += 1
        if not self._accept(float(stamp)):
            return False
        self._forget()
        ids, xy = self._clean(ids, xy)
        followed = self._followed(ids, xy, focus)
        self._append(ids[followed], xy[followed])
        return True

    def _forget(self) -> None:
        """Forget whom nobody saw for `timeout`."""
        recent = self.stamp - self._last <= self.timeout
        if recent.all():  # In most frames.
            return
        self.health["forgotten"] += int((~recent).sum())
        self._ids = self._ids[recent]
        self._last = self._last[recent]
        self._places = self._places[:, recent]
        self._velocity = self._velocity[recent]

    def complete(self) -> Observed:
        """Everybody with a window that ends at the newest frame.

        The velocity that goes on while a person is out of sight is that of the last
        `period` seen, or the line's.
        """
        absence = self.stamp - self._last
        people = np.flatnonzero(absence <= self.hold + SNAP)
        shape = len(people), self.steps
        last = self._last[people, None]
        back = np.arange(self.steps - 1, -1, -1)
        times = self.stamp - self.period * back
        window = np.broadcast_to(times, shape)
        ends = last - [0.0, self.period]
        # One call: each takes as long for two times as for ten.
        places = self._at(people, np.concatenate([window, ends], axis=1))
        positions = places[:, :-2].copy()
        now = places[:, -2]
        before = places[:, -1]
        velocity = (now - before) / self.period
        sighted = np.ones(shape, bool)
        seen, doubt = self._draw_lines(people, times, positions, velocity, sighted)

        # Who is out of sight goes on.
        ahead = times - last
        unseen = ahead > SNAP
        way = ahead[..., None] * velocity[:, None]
        going_on = now[:, None] + way
        positions = np.where(unseen[..., None], going_on, positions)
        observed = Observed(
            ids=self._ids[people],
            positions=positions,
            extrapolated=unseen.sum(axis=1),
            seen=seen,
            doubt=doubt,
            sighted=sighted,
        )
        is_whole = np.asarray(np.isfinite(positions).all(axis=(1, 2)))
        return observed.take(is_whole)

    def _draw_lines(
        self,
        people: np.ndarray,
        times: np.ndarray,
        positions: np.ndarray,
        velocity: np.ndarray,
        sighted: np.ndarray,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Complete `positions` [N, T, 2], and `velocity` [N, 2], of who was not seen at first.

        `sighted` [N, T] becomes False there.

        Returns:
            Seconds seen [N], and the standard deviations [N] of the lines' velocities.
        """
        length = times[-1] - times[0]
        seen = np.full(len(people), length)
        doubt = np.zeros(len(people))
        last = self._last[people]
        missing = np.isnan(positions[..., 0]) & (times <= last[:, None])
        for row in np.flatnonzero(missing.any(axis=1)):
            stamps, places = self._run(people[row])
            seen[row] = min(stamps[-1] - stamps[0], length)
            if len(stamps) < 2 or seen[row] < self.min_seen - SNAP:
                continue
            drawn = times <= last[row] + SNAP
            lines = lines_at(stamps, places, times[drawn])
            points = [line.at(time) for line, time in zip(lines, times[drawn])]
            positions[row, drawn] = points
            sighted[row, :-LEAST] = times[:-LEAST] >= stamps[0] - SNAP
            doubt[row] = lines[-1].doubt
            velocity[row] = lines[-1].velocity
        return seen, doubt

    def _run(self, person: int) -> tuple[np.ndarray, np.ndarray]:
        """Stamps [R] and places [R, 2] of a person since the last gap beyond `max_gap`."""
        seen = np.isfinite(self._places[:, person, 0])
        stamps = self._stamps[seen]
        places = self._places[seen, person]
        gaps = np.flatnonzero(np.diff(stamps) > self.max_gap + 2 * SNAP)
        begin = gaps[-1] + 1 if len(gaps) else 0
        return stamps[begin:], places[begin:]

    def incomplete(self, ids: np.ndarray) -> dict[int, str]:
        """Why others than `ids` are missing: "unseen" in the newest frame, or "short" windows."""
        missing = ~np.isin(self._ids, ids)
        why = np.where(self._last[missing] == self.stamp, "short", "unseen")
        return dict(zip(self._ids[missing].tolist(), why.tolist()))

    def resampled(self, ids: ArrayLike, times: ArrayLike) -> np.ndarray:
        """[N, T, 2] where people were at `times` [T], NaN where that is not known."""
        ids = np.asarray(ids)
        times = np.asarray(times, np.float64)
        positions = np.full((len(ids), len(times), 2), np.nan)
        if not len(ids):  # In most frames: whoever is followed has a forecast.
            return positions
        is_known = np.isin(ids, self._ids)
        people = np.searchsorted(self._ids, ids[is_known])
        all_times = np.broadcast_to(times, (len(people), len(times)))
        positions[is_known] = self._at(people, all_times)
        return positions

    def _at(self, people: np.ndarray, times: np.ndarray) -> np.ndarray:
        """[N, T, 2] positions of the columns `people` [N] at `times` [N, T]."""
        # Over the gap before it, nothing is bridged.
        oldest = times.min(initial=self.stamp) - self.max_gap - 4 * SNAP
        begin = np.searchsorted(self._stamps, oldest)
        stamps = self._stamps[begin:]
        places = self._places[begin:, people]
        before, after = _sightings(stamps, places, times)

        since = times - stamps[before]
        gap = stamps[after] - stamps[before]
        exact = np.abs(since) <= SNAP
        is_between = (gap > 0) & (gap <= self.max_gap + 2 * SNAP)
        is_known = (before >= 0) & (exact | is_between)
        weight = np.zeros_like(since)
        np.divide(since, gap, out=weight, where=is_known & ~exact)
        column = np.arange(len(people))[:, None]
        first = places[before, column]
        # In this form a person who stands still stays exactly still, as in `resample`.
        way = places[after, column] - first
        position = first + weight[..., None] * way
        return np.where(is_known[..., None], position, np.nan)

    def _accept(self, stamp: float) -> bool:
        """Whether this frame is the next; clears everything if the clock was set back."""
        back = self.stamp - stamp
        refused = ""
        if not abs(stamp) < LATE:
            refused = "bad_stamps"
        elif back == 0:
            refused = "duplicate_stamps"
        elif 0 < back < RESET and not self._behind:
            refused = "backward_stamps"
        if refused:
            self._behind |= back > 0
            self.health[refused] += 1
            return False
        if back > 0:
            self.health["clock_resets"] += 1
            self._clear()
        elif self.max_gap + 2 * SNAP < -back < math.inf:
            self.health["pauses"] += 1
        self.stamp, self._behind = stamp, False
        return True

    def _clean(self, ids: np.ndarray, xy: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The people of a frame whose id and position can be used."""
        ids = ids.astype(np.int64)
        xy = xy.reshape(-1, 2)
        finite = np.isfinite(xy).all(axis=1)
        near = (np.abs(xy) < FAR).all(axis=1)
        unique, first = np.unique(ids[near], return_index=True)
        self.health.update(
            bad_positions=int((~finite).sum()),
            far_positions=int((finite & ~near).sum()),
            duplicate_ids=int(near.sum()) - len(unique),
        )
        return unique, xy[near][first]

    def _followed(
        self, ids: np.ndarray, xy: np.ndarray, focus: ArrayLike | None
    ) -> np.ndarray:
        """[N] bool: who of a frame is followed: all who were, and as many newcomers as fit."""
        followed = np.isin(ids, self._ids)
        new = np.flatnonzero(~followed)
        room = self.max_tracks - len(self._ids)
        if len(new) > room:
            self.health["refused"] += len(new) - room
            order = nearest_first(xy, focus)
            new = order[~followed[order]][:room]
        followed[new] = True
        return followed

    def _append(self, ids: np.ndarray, xy: np.ndarray) -> None:
        """Add a frame; leave out frames that are too old."""
        oldest = self.stamp - self._kept
        begin = np.searchsorted(self._stamps, oldest, side="right")
        stamps = self._stamps[begin:]
        everybody = np.union1d(self._ids, ids)
        people = len(everybody)
        old = np.searchsorted(everybody, self._ids)
        new = np.searchsorted(everybody, ids)

        places = np.full((len(stamps) + 1, people, 2), np.nan)
        places[:-1, old] = self._places[begin:]
        last = np.full(people, -np.inf)
        last[old] = self._last
        velocity = np.full((people, 2), np.nan)
        velocity[old] = self._velocity

        # Of newcomers the gap is infinite, and the distance that to anybody.
        gap = self.stamp - last[new]
        before = np.searchsorted(stamps, last[new])
        moved = xy - places[before, new]
        jumped = is_jump(moved, velocity[new], gap)
        jumped &= gap <= self.max_gap + 2 * SNAP
        self.health["jumps"] += int(jumped.sum())
        places[:, new[jumped]] = np.nan
        places[-1, new] = xy
        last[new] = self.stamp
        velocity[new] = moved / gap[:, None]
        has_none = jumped | np.isinf(gap)
        velocity[new[has_none]] = np.nan

        self._ids = everybody
        self._last = last
        self._places = places
        self._velocity = velocity
        self._stamps = np.append(stamps, self.stamp)


def _sightings(
    stamps: np.ndarray, places: np.ndarray, times: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """[N, T] frames in which people were seen last at or before `times [N, T]`, and next.

    The first is -1 where there is none; the second is the first where there is none.
    `stamps [F]` are of `places [F, N, 2]`, NaN where a person was not seen.
    """
    count = len(stamps)
    frames = np.arange(count)[:, None]
    column = np.arange(places.shape[1])[:, None]
    seen = np.isfinite(places[..., 0])
    # For each frame, the last before it or itself in which a person was seen, and the
    # next.
    last = np.maximum.accumulate(np.where(seen, frames, -1))
    coming = np.where(seen, frames, count)[::-1]
    coming = np.minimum.accumulate(coming)[::-1]

    passed = np.searchsorted(stamps, times + SNAP, side="right")
    before = np.where(passed > 0, last[passed - 1, column], -1)
    following = np.minimum(passed, count - 1)
    after = np.where(passed < count, coming[following, column], count)
    return before, np.where(after < count, after, before)


def nearest_first(xy: np.ndarray, focus: ArrayLike | None) -> np.ndarray:
    """[N] order of positions [N, 2] by distance from `focus` [2], or else from their centre."""
    centre = xy.mean(axis=0) if focus is None else np.asarray(focus, np.float64)
    return np.argsort(np.linalg.norm(xy - centre, axis=1), kind="stable")
