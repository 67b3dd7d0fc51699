"""How a live stream goes, in a line for whoever watches a node; an alarm where it is stale."""

import dataclasses
import math
import time
from collections.abc import Callable, Mapping
from typing import Any

from neurosym_robot.online.analytics import Analytics
from neurosym_robot.online.predictor import Predictor

__all__ = ["STALE", "Status"]

STALE = 2.0
"""Seconds without people after which what was forecast says nothing of now."""


class Status:
    """Told of every frame by `heard`; `look` often, for it reports what has changed."""

    def __init__(
        self,
        predictor: Predictor,
        analytics: Analytics,
        report: Callable[[str], None],
        every: float = 10.0,
        counts: Callable[[], Mapping[str, int]] = dict,
        clock: Callable[[], float] = time.monotonic,
    ):
        """Nothing heard yet.

        Args:
            predictor: whose health is told.
            analytics: errors and latencies.
            report: is told, in one line each.
            every: seconds between lines on how it goes; 0 for none.
            counts: what else went wrong so far.
            clock: seconds.
        """
        self._predictor, self._analytics, self._counts = predictor, analytics, counts
        self._report, self._every, self._clock = report, every, clock
        self._heard = self._said = clock()
        self._first = True
        self._alarmed = False

    @property
    def age(self) -> float:
        """Seconds since the newest frame."""
        return self._clock() - self._heard

    @property
    def stale(self) -> bool:
        """Whether the newest frame is too old, or there was none."""
        return self._first or self.age > STALE

    def heard(self) -> None:
        """A frame was taken in."""
        if self._alarmed:
            self._report(f"people again, after {self.age:.0f} s")
        self._alarmed = self._first = False
        self._heard = self._clock()

    def look(self) -> None:
        """Report what is due."""
        if self.stale and not self._first and not self._alarmed:
            self._alarmed = True
            self._report(f"stale: no people for {self.age:.0f} s, forecasts have ended")
        if self._every and self._clock() - self._said >= self._every:
            self._said = self._clock()
            self._report(self.line())

    def wrong(self) -> dict[str, int]:
        """What was wrong so far, in words, where there was anything."""
        health = dataclasses.asdict(self._predictor.health)
        health.pop("frames")
        counts = {**health, **self._counts()}
        return {name.replace("_", " "): count for name, count in counts.items() if count}

    def line(self) -> str:
        """How it goes."""
        summary = self._analytics.summary()
        parts = [f"{self._predictor.health.frames} frames, {summary['forecasts']} forecasts"]
        if self.stale:
            parts.append("no people yet" if self._first else f"stale for {self.age:.0f} s")
        recent, whole = _how(summary["recent"]), _how(summary)
        if recent:
            parts.append(f"last minute: {recent}")
        if whole and summary["forecasts"] > summary["recent"]["forecasts"]:
            parts.append(f"altogether: {whole}")
        wrong = [f"{name} {count}" for name, count in self.wrong().items()]
        return "; ".join(parts + ([", ".join(wrong)] if wrong else []))


def _how(summary: Mapping[str, Any]) -> str:
    """Latency and errors."""
    if not summary["forecasts"]:
        return ""
    latency = summary["latency_ms"]
    parts = [f"latency p50 {latency['p50']:.1f} ms, p99 {latency['p99']:.1f} ms"]
    parts += [
        f"{name} ADE {means['joint_ade']:.2f} m, FDE {means['joint_fde']:.2f} m"
        for name, means in summary["models"].items()
        if means["people"] and math.isfinite(means["joint_ade"])
    ]
    return ", ".join(parts)
