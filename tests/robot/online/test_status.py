"""Age of information: what is old is called old, and two clocks that differ are told apart."""

from collections import Counter
from types import SimpleNamespace
from typing import Any

import pytest

from neurosym_robot.online.status import ARRIVALS, Status


class Clocked:
    """A status, the lines that it reports, and a clock that is set by hand."""

    def __init__(self):
        self.now, self.said = 1000.0, []
        self.predictor: Any = SimpleNamespace(
            health=Counter(), window=SimpleNamespace(reset_after=5.0), dropped={}
        )
        summary = {"forecasts": 0, "dropped": {}, "models": {}}
        analytics: Any = SimpleNamespace(summary=lambda: summary)
        report = self.said.append
        self.status = Status(self.predictor, analytics, report, 0.0, clock=lambda: self.now)

    def run(self, seconds: float, late: float) -> None:
        """Ten frames a second, each `late` when it comes."""
        for _ in range(round(10 * seconds)):
            self.now += 0.1
            self.status.heard(self.now - late)
            self.status.published(late + 0.005)
            self.status.look()


def test_a_stream_is_stale_by_its_age_and_says_when_it_is_back():
    stream = Clocked()
    stream.status.look()
    assert stream.status.stale  # Nothing came yet, which is no alarm.
    stream.run(5, late=0.02)
    assert not stream.status.stale
    assert stream.said == []
    assert stream.status.now()["p99"] == pytest.approx(25)
    stream.now += 3.0
    stream.status.look()
    stream.status.look()
    assert stream.said == ["stale: the newest people are 3.0 s old"]
    stream.run(0.1, late=0.02)
    assert stream.said[1:] == ["people again"]


def test_a_growing_backlog_is_stale_though_frames_come():
    stream = Clocked()
    stream.run(5, late=0.02)
    for late in (0.5, 1.0, 1.5, 2.5):
        stream.run(1, late)
    assert stream.status.stale
    assert stream.status.offset == 0
    assert len(stream.said) == 1
    assert stream.status.now()["age"] == pytest.approx(2505)


@pytest.mark.parametrize(("late", "way"), [(30.0, "behind"), (-7.0, "ahead of")])
def test_a_constant_offset_is_told_and_not_called_stale(late, way):
    stream = Clocked()
    stream.run(ARRIVALS / 10, late)
    (line,) = stream.said
    assert f"stamps are {abs(late):.1f} s {way} this computer's clock, constantly" in line
    assert not stream.status.stale
    assert stream.status.offset == pytest.approx(late)
    assert f"of which {late:.1f} s are a constant offset" in stream.status.line()
    stream.now += 2.5
    assert stream.status.stale


def test_counts_and_a_table_of_little():
    stream = Clocked()
    stream.predictor.health = Counter(frames=3, duplicate_stamps=2)
    stream.status.published(0.01, skipped=4)
    assert stream.status.wrong() == {"skipped": 4, "duplicate stamps": 2}
    table = stream.status.table()
    assert "nobody was seen" in table
    assert "skipped 4, duplicate stamps 2" in table
    assert "no people yet" in stream.status.line()
