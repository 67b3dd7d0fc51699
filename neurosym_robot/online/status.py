"""How fresh a stream is: age of information, input rate, skipped frames; a line, an alarm, a table.

The age of information is one number: from a frame's header stamp to the moment its
forecast is published, by ROS's clock.
"""

import collections
import math
import time
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from neurosym_robot.input.source import PeopleSource
from neurosym_robot.online.predictor import Predictor
from neurosym_robot.online.regions import SPAN
from neurosym_robot.online.replay import PUBLISHED, Analytics
from neurosym_robot.tracking.stitching import OnlineStitcher

# seconds of age from which on forecasts no longer describe the present
STALE_AFTER = 2.0
# seconds: a least age beyond it is an offset between two clocks, and reported
OFFSET = 0.5
AGES = 4096  # newest ages kept for the percentiles
ARRIVALS = 30  # newest frames whose rate is told
EXPLAINED = "published: the central forecast; joint, marginal: the best of the samples by hindsight"
FLOWS = 30.0  # seconds of watching between two pictures of what a place taught
REPORTS = 4  # newest reports that are shown


class Status:
    """Call `heard` at every frame, `published` at every forecast, and `look` often to report."""

    def __init__(
        self,
        predictor: Predictor,
        analytics: Analytics,
        report: Callable[[str], None] = print,
        interval: float = 10.0,
        stale_after: float = STALE_AFTER,
        clock: Callable[[], float] = time.time,
        source: PeopleSource | None = None,
        stitcher: OnlineStitcher | None = None,
    ):
        """Before the first frame.

        `report` is called with one line at a time, the status every `interval` seconds
        (0: never); `clock` returns the time [s] that stamps are compared with; what
        `source` left out and `stitcher` joined is told with the rest.
        """
        self._predictor, self._analytics = predictor, analytics
        self._report, self._every, self.stale_after = report, interval, stale_after
        self._clock, self._source = clock, source or PeopleSource()
        self._stitcher = stitcher or OnlineStitcher()
        self._said = time.monotonic()
        self._drawn_at = 0.0
        self._flows: list[list[float]] = []
        self._newest = math.nan  # stamp of the newest frame
        # age of the newest frame, and when it had it
        self._lag: tuple[float, float] | None = None
        self._least = math.inf  # least age of a frame that arrived
        self._offset_said = self._alarmed = False
        self._ages: collections.deque[float] = collections.deque(maxlen=AGES)
        self._oldest = -math.inf  # greatest age of a forecast
        self._arrivals: collections.deque[float] = collections.deque(maxlen=ARRIVALS)
        self._steps: collections.deque[float] = collections.deque(maxlen=ARRIVALS)
        self.skipped = 0
        """Frames that were observed but not forecast, because a newer one waited."""

    @property
    def age(self) -> float:
        """Seconds since the stamp of the newest frame; NaN before the first."""
        if self._lag is not None:
            return self._lag[0] + time.monotonic() - self._lag[1]
        return self._clock() - self._newest

    @property
    def rate(self) -> float:
        """Frames a second, of the newest ones; it falls while none come, and is 0 at first."""
        arrivals, now = self._arrivals, time.monotonic()
        if len(arrivals) < 2:
            return 0.0
        step = (arrivals[-1] - arrivals[0]) / (len(arrivals) - 1)
        return 1 / max(
            step, now - arrivals[-1] if now - arrivals[-1] > 2 * step else 0.0, 1e-6
        )

    @property
    def offset(self) -> float:
        """Seconds that every frame was older than 0 when it came, if that is no transport."""
        return self._least if OFFSET < abs(self._least) < math.inf else 0.0

    @property
    def stale(self) -> bool:
        """Whether the newest frame is older than `stale_after`, or there was none."""
        return not self.age - self.offset <= self.stale_after

    def heard(self, stamp: float, age: float | None = None) -> None:
        """Note that the frame of this stamp came, `age` seconds old; by default by the clock."""
        if stamp < self._newest - OFFSET:  # The clock was set back.
            self._least, self._newest, self._offset_said = math.inf, math.nan, False
        self._steps.append(stamp - self._newest)
        self._newest = stamp if math.isnan(self._newest) else max(stamp, self._newest)
        self._lag = None if age is None else (age, time.monotonic())
        self._least = min(self._least, self.age)
        self._arrivals.append(time.monotonic())
        if self.offset and not self._offset_said and len(self._arrivals) == ARRIVALS:
            self._offset_said = True
            way = "behind" if self.offset > 0 else "ahead of"
            self._report(
                f"stamps are {abs(self.offset):.1f} s {way} this computer's clock, constantly: "
                "the clocks of two computers differ, a recording is played, or the tracker is late"
            )

    def published(self, age: float, skipped: int = 0) -> None:
        """Note the age of a forecast, and how many older frames it left without one."""
        self._ages.append(age)
        self._oldest = max(self._oldest, age)
        self.skipped += skipped

    def look(self) -> None:
        """Report what is due."""
        if self.stale != self._alarmed and math.isfinite(self._newest):
            self._alarmed = self.stale
            late = f"stale: the newest people are {self.age - self.offset:.1f} s old"
            self._report(late if self.stale else "people again")
        if self._every and time.monotonic() - self._said >= self._every:
            self._said = time.monotonic()
            self._report(self.line())

    def wrong(self) -> dict[str, int]:
        """Counts of problems so far, by name in words, without zeros."""
        counts = {
            "skipped": self.skipped,
            **self._predictor.health,
            **self._source.refused,
        }
        counts |= {"tracks joined": self._stitcher.joined, "frames": 0}
        return {
            name.replace("_", " "): count for name, count in counts.items() if count
        }

    def now(self) -> dict[str, Any]:
        """JSON-able: ages [ms], their constant `offset` [s], `rate` [Hz], counts,
        `missing` people with reasons by id, what was reported, the `score`, what the
        `place` brought in words, and the `flows` of people there.

        `age` is that of the newest forecast, `lag` that of the newest people [s],
        without offset.
        """
        ages, lag = [None] * 3, self.age - self.offset
        if self._ages:
            newest = 1e3 * np.append(
                self._ages[-1], np.percentile(self._ages, (50, 99))
            )
            ages = np.round(newest, 1).tolist()
        return {
            **dict(zip(("age", "p50", "p99"), ages)),
            "lag": None if math.isnan(lag) else round(max(lag, 0.0), 3),
            "offset": round(self.offset, 2),
            "stale_after": self.stale_after,
            "rate": round(self.rate, 2),
            "skipped": self.skipped,
            "wrong": self.wrong(),
            "reports": list(self._source.reports)[-REPORTS:],
            "missing": dict(self._predictor.dropped),
            "score": self._analytics.summary(),
            "place": self._place_in_words(),
            "flows": self._flows_now(),
        }

    def line(self) -> str:
        """The status line."""
        now, late = (
            self.now(),
            f"stale for {self.age - self.offset:.0f} s" if self.stale else "",
        )
        scored = now["score"]["models"].items()
        errors = [_errors_in_words(*row) for row in scored if row[1]["people"]]
        parts = [
            self._counted(now),
            "no people yet" if math.isnan(self._newest) else late,
            self._ages_in_words(now),
            self._slowness(),
            *errors,
            now["place"],
            _listed(now["wrong"]),
        ]
        return "; ".join(filter(None, parts))

    def table(self) -> str:
        """The stream and its errors, at the end: several lines."""
        now = self.now()
        summary = now["score"]
        nobody = "nobody was forecast"
        if summary["forecasts"]:
            nobody = "no person's forecast could be compared with what happened"
        lines = [
            f"{self._counted(now)}; metres",
            _table(summary["models"]) or nobody,
            self._ages_in_words(now),
            self._slowness(),
            now["place"],
            _listed(summary["dropped"], "people without a forecast or a score: "),
            _listed(now["wrong"], "wrong with the stream: "),
        ]
        return "\n".join(filter(None, lines))

    def _counted(self, now: Mapping[str, Any]) -> str:
        return f"{self._predictor.health['frames']} frames, {now['score']['forecasts']} forecasts"

    def _slowness(self) -> str:
        """What to do where most frames come too seldom to be joined; else empty."""
        step = np.nanmedian([math.nan, *self._steps]) if len(self._steps) > 1 else 0.0
        if not step > self._predictor.window.max_gap:
            return ""
        advice = f"--max-gap {math.ceil(2 * step)} bridges the time between them"
        return f"frames come every {step:.1f} s: {advice}"

    def _place_in_words(self) -> str:
        """How much of a forecast the place gives, and what that brought; else empty."""
        place = self._predictor.place
        if place is None:
            return ""
        share = 100 * (1 - place.shares["network"])
        text = f"memory of the place: up to {share:.0f} % of a forecast"
        if place.drops:
            text += f", dropped {place.drops} times since it made forecasts worse"
        people, alone, used = place.scored
        if not people:
            return f"{text}, not scored yet"
        change = 100 * (used / max(alone, 1e-9) - 1)
        way = "higher" if change > 0 else "lower"
        text += (
            f", error {abs(change):.1f} % {way} than without it "
            f"in {place.seconds / 60:.0f} minutes"
        )
        interval = place.change.interval()
        if interval is None:
            return text
        mean, half = interval
        text += f" (± {100 * half:.1f} %"
        if abs(mean) <= half:
            text += ", may be chance"
        return text + ")"

    def _flows_now(self) -> list[list[float]] | None:
        """Rows of start, way [m], share and people; new ones once in `FLOWS` seconds watched."""
        place = self._predictor.place
        if place is None:
            return None
        if place.seconds - self._drawn_at >= FLOWS:
            self._drawn_at = place.seconds
            columns = [column.T for column in place.flows()]
            self._flows = np.round(np.vstack(columns).T, 2).tolist()
        return self._flows

    def _ages_in_words(self, now: Mapping[str, Any]) -> str:
        offset = (
            f", of which {self.offset:.1f} s are a constant offset"
            if self.offset
            else ""
        )
        most = (
            f"{now['p50']} ms, p99 {now['p99']} ms, at most {1e3 * self._oldest:.1f} ms"
        )
        return f"age of information p50 {most}{offset}" if self._ages else ""


def _errors_in_words(name: str, means: Mapping[str, Any]) -> str:
    ade, fde = means["published_ade"], means["published_fde"]
    text = f"{name} ADE {ade:.2f} m, FDE {fde:.2f} m"
    if "joint_ade" in means:
        best = f"{means['joint_ade']:.2f}, {means['joint_fde']:.2f}"
        text += f" (best of the samples {best})"
    return text + _coverage_in_words(means["coverage"])


def _coverage_in_words(coverage: Mapping[str, float]) -> str:
    """Such as `, 50 % regions held 48 %, 90 % regions 91 % in the last 5 minutes`; else empty."""
    shares = [
        f"{level} % regions held {100 * share:.0f} %"
        for level, share in coverage.items()
    ]
    return (
        f", {', '.join(shares)} in the last {SPAN / 60:.0f} minutes" if shares else ""
    )


def _listed(counts: Mapping[str, int], title: str = "") -> str:
    """Counts in one line; empty without any."""
    text = ", ".join(f"{name} {count}" for name, count in counts.items())
    return text and title + text


def _table(models: dict[str, dict[str, Any]]) -> str:
    """Models in rows, metrics with a single number in columns; empty where nobody was scored."""
    scored = {model: means for model, means in models.items() if means["people"]}
    if all("joint_ade" not in means for means in scored.values()):
        return "\n".join(_errors_in_words(*row) for row in scored.items())
    from neurosym_jax.evaluation.metrics import METRICS, metric_names
    from neurosym_jax.evaluation.tables import aligned_table

    names = metric_names()
    for row in scored.values():
        names = [name for name in names if type(row[name]) is not list]
    rows = []
    for model, row in scored.items():
        published = [f"{row[name]:.3f}" for name in PUBLISHED]
        metrics = [METRICS[name].text(row[name]) for name in names]
        runtime = "-"
        if row["runtime"] is not None:
            runtime = f"{row['runtime']:.1f} ms"
        rows.append([model, *published, *metrics, runtime, str(row["people"])])
    head = [
        "",
        "published ADE",
        "published FDE",
        *(METRICS[name].title for name in names),
    ]
    table = aligned_table([[*head, "runtime", "people scored"], *rows]) if rows else ""
    return table and f"{table}\n{EXPLAINED}"
