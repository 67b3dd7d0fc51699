"""A long run on a robot: nothing grows, nothing is compiled on the way, nobody is forgotten."""

import gc
import os
from pathlib import Path

import numpy as np
import pytest

from neurosym_robot.online.analytics import Analytics
from neurosym_robot.online.predictor import Predictor
from tests.compiling import compile_seconds

RATE, PEOPLE, OBS = 10, 12, 4
MEMORY = Path("/proc/self/statm")


def resident() -> int:
    """Bytes of memory that this process holds."""
    gc.collect()
    return int(MEMORY.read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")


@pytest.mark.slow
@pytest.mark.skipif(not MEMORY.exists(), reason="memory is read from Linux's /proc")
@pytest.mark.parametrize("minutes", [3, pytest.param(60, marks=pytest.mark.exhaustive)])
def test_people_come_and_go_for_long(model, minutes):
    rng, frames = np.random.default_rng(0), 60 * RATE * minutes
    # Two never leave; the others stay a minute at most, and somebody else comes to their place.
    stay = np.append([frames, frames], rng.integers(30, 600, PEOPLE - 2))
    absent = rng.integers(25, 300, PEOPLE) * (stay < frames)
    place, step = rng.uniform(0, 20, (PEOPLE, 2)), rng.normal(0, 5e-3, (PEOPLE, 2))
    predictor = Predictor(model("as_described"), samples=2, max_people=PEOPLE)
    analytics, compiled = Analytics(predictor), compile_seconds()
    memory, count = [], 0
    for frame in range(frames):
        visit, since = np.divmod(frame, stay + absent)
        here = since < stay
        ids = np.arange(PEOPLE) + PEOPLE * visit
        # It begins at a clock that counts from 1970, with frames that tremble by 2 ms.
        stamp = 1.7e9 + frame / RATE + (2e-3 * np.sin(frame) if frame % 4 else 0.0)
        forecast = predictor.push(stamp, ids[here], (place + step * since[:, None])[here])
        analytics.add(forecast)
        if forecast is not None:
            count += 1
            # Whose window begins within the trembling of its first frame may have it or not.
            whole, sure = (here & (since >= 4 * (OBS - 1) + n) for n in (0, 1))
            assert set(ids[sure]) <= set(forecast.ids.tolist()) <= set(ids[whole])
        if frame % (frames // 6) == frames // 12:
            memory.append(resident())
    assert count >= frames - 4 * (OBS - 1) - 1  # With every frame.
    assert compile_seconds() == compiled
    assert max(memory) - memory[0] < (8e6 if minutes == 60 else 3e6), memory
    health = dict(predictor.health)
    assert health.pop("frames") == frames
    assert health.pop("forgotten") > visit.sum() - PEOPLE
    assert not any(health.values()), health
    summary = analytics.summary()
    assert summary["forecasts"] == count
    assert summary["dropped"].keys() <= {"short", "unseen", "future unknown"}
