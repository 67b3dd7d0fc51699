"""Reports on a stream: a table at its end, a line while it is live, an alarm when it is stale."""

import dataclasses
import math
import time
from collections.abc import Callable, Mapping
from typing import Any

from neurosym_jax.evaluation.metrics import METRICS, metric_names
from neurosym_robot.online.analytics import Analytics
from neurosym_robot.online.predictor import Predictor
from neurosym_robot.online.window import Health

__all__ = ["STALE", "Status", "format_summary"]

STALE = 2.0  # seconds without people after which forecasts no longer describe the present


def format_summary(summary: dict[str, Any], health: Health) -> str:
    """A table of `Analytics.summary()`, and what was wrong with the stream."""
    lines = [f"{health.frames} frames, {summary['forecasts']} forecasts; metres"]
    models = {name: means for name, means in summary["models"].items() if means["people"]}
    if models:
        lines += _table(models)
    elif summary["forecasts"]:
        lines.append("  nobody whose forecast could be compared with what happened")
    else:
        lines.append("  nobody was seen for a whole observation window")
    if summary["forecasts"]:
        latency = summary["latency_ms"].items()
        times = ", ".join(f"{name} {value:.2f} ms" for name, value in latency)
        lines.append(f"latency from frame to forecast: {times}")
    for text, reasons in (
        ("people without a forecast or a score", summary["dropped"]),
        ("wrong with the stream", _wrong(health)),
    ):
        if reasons:
            shown = [f"{name} {count}" for name, count in reasons.items()]
            lines.append(f"{text}: {', '.join(shown)}")
    return "\n".join(lines)


class Status:
    """Status of a live stream: call `heard` at every frame, and `look` often to report changes."""

    def __init__(
        self,
        predictor: Predictor,
        analytics: Analytics,
        report: Callable[[str], None],
        every: float = 10.0,
        counts: Callable[[], Mapping[str, int]] = dict,
        clock: Callable[[], float] = time.monotonic,
    ):
        """Before the first frame.

        Args:
            predictor: its health is reported.
            analytics: its errors and latencies are reported.
            report: called with one line at a time.
            every: seconds between status lines; 0 for none.
            counts: returns counts of other problems.
            clock: returns seconds.
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
        """Whether the newest frame is older than `STALE`, or there was none."""
        return self._first or self.age > STALE

    def heard(self) -> None:
        """Note that a frame came."""
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
        """Counts of problems so far, by name in words, without zeros."""
        return _wrong(self._predictor.health, self._counts())

    def line(self) -> str:
        """The status line."""
        summary = self._analytics.summary()
        parts = [f"{self._predictor.health.frames} frames, {summary['forecasts']} forecasts"]
        if self.stale:
            parts.append("no people yet" if self._first else f"stale for {self.age:.0f} s")
        recent, whole = _scores(summary["recent"]), _scores(summary)
        if recent:
            parts.append(f"last minute: {recent}")
        if whole and summary["forecasts"] > summary["recent"]["forecasts"]:
            parts.append(f"altogether: {whole}")
        wrong = [f"{name} {count}" for name, count in self.wrong().items()]
        return "; ".join(parts + ([", ".join(wrong)] if wrong else []))


def _table(models: dict[str, dict[str, Any]]) -> list[str]:
    """Lines of a table: models in rows, metrics with a single number in columns."""
    names = [
        name
        for name in metric_names()
        if not any(isinstance(means[name], list) for means in models.values())
    ]
    rows = [("", *(METRICS[name].title.rpartition(" ")[n] for name in names)) for n in (0, 2)]
    rows = [(*rows[0], "people"), (*rows[1], "scored")]
    for model, means in models.items():
        cells = [METRICS[name].text(means[name]) for name in names]
        rows.append((model, *cells, str(means["people"])))
    first, *widths = [max(map(len, column)) for column in zip(*rows)]
    return [
        f"  {row[0]:{first}}  "
        + "  ".join(f"{text:>{width}}" for text, width in zip(row[1:], widths))
        for row in rows
    ]


def _wrong(health: Health, more: Mapping[str, int] | None = None) -> dict[str, int]:
    counts = {**dataclasses.asdict(health), **(more or {})}
    counts.pop("frames")
    return {name.replace("_", " "): count for name, count in counts.items() if count}


def _scores(summary: Mapping[str, Any]) -> str:
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
