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


def presence(rng: np.random.Generator, frames: int) -> list[tuple[int, int, int]]:
    """Who is there from which frame to which, one place after the other: (id, first, last)."""
    visits, id = [], 0
    for place in range(PEOPLE):
        # Two never leave, so that there is always somebody to forecast.
        frame = 0 if place < 2 else int(rng.integers(600))
        while frame < frames:
            last = frames if place < 2 else frame + int(rng.integers(5, 900))
            visits.append((id, frame, min(last, frames) - 1))
            frame, id = last + int(rng.integers(1, 300)), id + 1
    return visits


@pytest.mark.slow
@pytest.mark.skipif(not MEMORY.exists(), reason="memory is read from Linux's /proc")
@pytest.mark.parametrize("minutes", [5, pytest.param(60, marks=pytest.mark.exhaustive)])
def test_people_come_and_go_for_long(model, minutes):
    rng, frames = np.random.default_rng(0), 60 * RATE * minutes
    visits = np.array(presence(rng, frames))
    id, first, last = visits.T
    place, step = rng.uniform(0, 20, (len(id), 2)), rng.normal(0, 0.1, (len(id), 2))
    step[:2] *= 0.05  # Those who stay do not walk off the map.
    predictor = Predictor(model("as_described"), samples=2, max_people=PEOPLE)
    analytics, compiled = Analytics(predictor), compile_seconds()
    memory, count = [], 0
    for frame in range(frames):
        here = (first <= frame) & (frame <= last)
        xy = place[here] + step[here] * (frame - first[here])[:, None]
        # It begins at a clock that counts from 1970, with frames that tremble by 2 ms.
        stamp = 1.7e9 + frame / RATE + (2e-3 * np.sin(frame) if frame % 4 else 0.0)
        forecast = predictor.push(stamp, id[here], xy)
        analytics.add(forecast)
        if forecast is not None:
            count += 1
            # Whose window begins within the trembling of its first frame may have it or not.
            whole, sure = (here & (first <= frame - 4 * (OBS - 1) - n) for n in (0, 1))
            ids = set(forecast.ids.tolist())
            assert set(id[sure].tolist()) <= ids <= set(id[whole].tolist())
        if frame % (frames // 6) == frames // 12:
            memory.append(resident())
    assert count >= frames - 4 * (OBS - 1) - 1  # With every frame.
    assert compile_seconds() == compiled
    assert max(memory) - memory[0] < (8e6 if minutes == 60 else 3e6), memory
    health = vars(predictor.health)
    assert health.pop("frames") == frames
    assert health.pop("forgotten") > len(id) - 2 * PEOPLE
    assert not any(health.values()), health
    summary = analytics.summary()
    assert summary["forecasts"] == count
    assert summary["dropped"].keys() <= {"short", "unseen", "future unknown"}
