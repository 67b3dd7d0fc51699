"""Regions that hold what they say, whatever the place: online recalibration of a distribution.

A region of a level is where a person is forecast to be at a step: an ellipse around the
mean of the draws, with their covariance. The radius that holds the level's share of the
draws is right where the model is. Elsewhere it is scaled by a factor that grows when a truth lies
outside and shrinks when it lies inside, so that in the long run the region holds its
level at any place (adaptive conformal inference: Gibbs and Candès, NeurIPS 2021; as
quantile tracking: Angelopoulos et al., NeurIPS 2023). Factors are bounded: beyond
`WIDEST` a forecast is worth nothing, and coverage is no longer kept.
"""

import collections
import dataclasses
import math
from typing import Any, NamedTuple

import numpy as np

from neurosym_jax.data.tracks import SNAP
from neurosym_robot.online.window import Window

LEVELS = (0.5, 0.9)
"""Shares of true positions that regions should hold."""
WIDEST = 30.0
"""Largest factor of a region's size, and the inverse of the smallest."""
FLOOR = 0.02
"""Standard deviation added to the draws', metres: people are tracked no better."""
LEAST = 0.1
"""Least radius, in standard deviations."""
RATE = 0.1
"""Change of a factor's logarithm for a person outside its region, and of all steps' beside it."""
MOST = 10
"""People at a step that count for a change; of more each one counts for less."""
SPAN = 300.0
"""Seconds over which coverage is told."""


@dataclasses.dataclass(frozen=True, eq=False)
class Regions:
    """Ellipses around the means of N people at T steps, by level."""

    mean: np.ndarray  # [N, T, 2] metres
    covariance: np.ndarray  # [N, T, 2, 2] square metres
    radius: np.ndarray  # [L, N, T] where a region ends, in standard deviations

    @classmethod
    def around(cls, draws: np.ndarray, scale: np.ndarray | float = 0.0) -> "Regions":
        """The regions of `draws [n, N, T, 2]`; `scale [L, T]` as of `Recalibration`."""
        count, _, steps, _ = draws.shape
        mean = draws.mean(axis=0)
        deviation = draws - mean
        covariance = np.einsum("knti,kntj->ntij", deviation, deviation) / count
        covariance += FLOOR**2 * np.eye(2)

        # The radius that holds the level's share of the draws.
        distance = _distance(deviation, covariance)
        distance.sort(axis=0)
        ranks = [math.ceil(level * count) - 1 for level in LEVELS]
        radius = np.maximum(distance[ranks], LEAST)
        scale = np.broadcast_to(scale, (len(LEVELS), steps))
        factor = np.exp(scale)
        return cls(mean, covariance, radius * factor[:, None])

    def factors(self, step: int, truth: np.ndarray) -> np.ndarray:
        """[L, N] logarithms of the factors from which on regions of `step` hold `truth [N, 2]`."""
        deviation = truth - self.mean[:, step]
        distance = _distance(deviation, self.covariance[:, step])
        distance = np.maximum(distance, 1e-6)
        return np.log(distance / self.radius[:, :, step])

    def outlines(self, step: int, points: int = 32) -> np.ndarray:
        """[L, N, points, 2] metres of the ellipses at a step."""
        turn = np.linspace(0, 2 * np.pi, points, endpoint=False)
        circle = np.stack([np.cos(turn), np.sin(turn)])
        root = np.linalg.cholesky(self.covariance[:, step])
        ellipse = root @ circle  # [N, 2, points]
        ring = ellipse.swapaxes(1, 2)
        radius = self.radius[:, :, step, None, None]
        return self.mean[:, step, None] + radius * ring

    def axes(self) -> tuple[np.ndarray, np.ndarray]:
        """Half axes [N, T, 2] of the ellipses of radius 1, metres, and the first one's angle."""
        variance, direction = np.linalg.eigh(self.covariance)
        angle = np.arctan2(direction[..., 1, 1], direction[..., 0, 1])
        return np.sqrt(variance[..., ::-1]), angle


def _distance(deviation: np.ndarray, covariance: np.ndarray) -> np.ndarray:
    """Length of `deviation [..., 2]` in standard deviations of `covariance [..., 2, 2]`."""
    inverse = np.linalg.inv(covariance)
    solved = (inverse @ deviation[..., None])[..., 0]
    square = (deviation * solved).sum(axis=-1)
    return np.sqrt(square)


class _Watch:
    """A forecast whose truth is still to come."""

    def __init__(
        self, stamp: float, ids: np.ndarray, regions: Regions, scale: np.ndarray
    ):
        """Of the people `ids [N]`, with the `scale [L, T]` as it is at the `stamp` [s]."""
        self.stamp, self.ids, self.regions, self.scale = stamp, ids, regions, scale
        self.steps = 0
        """Steps whose truth has come."""


class _Held(NamedTuple):
    """How many truths regions held at a moment."""

    stamp: float
    people: int  # whose truth came
    held: np.ndarray  # [L] of them in their regions


class Recalibration:
    """Scales of the regions of one model, and the shares of truths that these regions held."""

    def __init__(self, window: Window):
        """Start at the model's own regions; `window` will have the truth."""
        self._window = window
        self.scale: Any = np.zeros((len(LEVELS), 1))
        """[L, T] logarithms of the factors of the regions' size."""
        self._watched = collections.deque[_Watch]()
        self._held = collections.deque[_Held]()

    def add(self, stamp: float, ids: np.ndarray, draws: np.ndarray) -> None:
        """Follow a forecast for the people `ids [N]` by `draws [n, N, T, 2]`."""
        shape = len(LEVELS), draws.shape[2]
        self.scale = np.broadcast_to(self.scale, shape).copy()
        regions = Regions.around(draws)
        self._watched.append(_Watch(stamp, ids, regions, self.scale.copy()))

    def learn(self) -> None:
        """Take in the truth that has come to the window."""
        steps = self.scale.shape[1]
        change = np.zeros_like(self.scale)
        seen = np.zeros(steps, bool)
        for watch in self._watched:
            while watch.steps < steps:
                step = watch.steps
                stamp = watch.stamp + self._window.period * (step + 1)
                if stamp > self._window.stamp + SNAP:
                    break
                truth = self._window.resampled(watch.ids, [stamp])[:, 0]
                is_known = np.asarray(np.isfinite(truth).all(axis=1))
                if is_known.any():
                    change[:, step] += self._compare(watch, truth, is_known)
                    seen[step] = True
                watch.steps += 1

        while self._watched and self._watched[0].steps == steps:
            self._watched.popleft()
        if not seen.any():
            return
        # What is wrong with one step is mostly wrong with all, and the first come first.
        change += change[:, seen].mean(axis=1, keepdims=True)
        scale = self.scale + RATE * change
        bound = math.log(WIDEST)
        self.scale = np.clip(scale, -bound, bound)

    def clear(self) -> None:
        """Forget the forecasts whose truth never comes."""
        self._watched.clear()

    def coverage(self) -> dict[float, float]:
        """By level, the share of true positions of the last `SPAN` seconds in its region."""
        people = 0
        held = np.zeros(len(LEVELS))
        for moment in self._held:
            people += moment.people
            held += moment.held
        if not people:
            return {}
        shares = held / people
        return dict(zip(LEVELS, shares.tolist()))

    def _compare(
        self, watch: _Watch, truth: np.ndarray, is_known: np.ndarray
    ) -> np.ndarray:
        """[L] people outside their region beyond those expected, of those `is_known [N]`."""
        step = watch.steps
        count = int(is_known.sum())
        now = self._window.stamp
        factors = watch.regions.factors(step, truth)[:, is_known]
        is_held = factors <= watch.scale[:, step, None]
        self._held.append(_Held(now, count, is_held.sum(axis=1)))
        while self._held[0].stamp < now - SPAN:
            self._held.popleft()

        # By the scale of now, so that what is learned late is not learned twice.
        is_outside = factors > self.scale[:, step, None]
        expected = 1 - np.array(LEVELS)
        excess = is_outside.mean(axis=1) - expected
        return min(count, MOST) * excess
