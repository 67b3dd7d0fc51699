"""What a place costs a robot: a frame of sixty people, with and without what was learned.

People walk at random, ten frames a second. Measured is the time from a frame to the
draws of everybody, and then that of learning, which comes after. The memory is full: a
hundred thousand moments at random, where people walk.
"""

import time
from typing import Any

import numpy as np

from benchmarks.timing import OURS, Row, apart, row

PEOPLE = 60
MOMENTS = 100_000
FRAMES = 200
"""For each repeat."""
WARM = 60
"""Frames that are not counted: programs compile, and the first steps come to be known."""
MODEL = "recommended"


def measure(options: Any) -> dict[str, Any]:
    """See the module."""
    table: list[Row] = []
    count = FRAMES * options.repeats
    for case, moments in (("no place", 0), (f"{MOMENTS:,} moments", MOMENTS)):
        forecast, learn = apart(_frames, moments, count)
        table.append(_row(f"{PEOPLE} people, {case}, to the draws", forecast))
        if moments:
            table.append(_row(f"{PEOPLE} people, {case}, learning", learn))
    return {"title": "a frame where a place is watched", "rows": table}


def _row(case: str, seconds: list[float]) -> Row:
    return row(case, OURS, seconds, p99=float(np.percentile(seconds, 99)))


def _frames(moments: int, frames: int) -> tuple[list[float], list[float]]:
    """Seconds to the draws of each frame, and seconds of learning from it."""
    from neurosym_jax.models.disk import find_model, load_model
    from neurosym_robot.online.predictor import Predictor

    model = load_model(find_model(MODEL))
    place = _full(model, moments) if moments else None
    predictor = Predictor(model, max_people=PEOPLE, place=place)
    rng = np.random.default_rng(0)
    position = rng.uniform(-10, 10, (PEOPLE, 2))
    velocity = rng.normal(0, 1, (PEOPLE, 2))
    forecast_seconds, learn_seconds = [], []
    for frame in range(WARM + frames):
        velocity += rng.normal(0, 0.05, velocity.shape)
        position = position + 0.1 * velocity
        began = time.perf_counter()
        predictor.window.push(frame / 10, np.arange(PEOPLE), position)
        for result in predictor.forecast().models.values():
            result.draws  # noqa: B018
        forecast_seconds.append(time.perf_counter() - began)
        predictor.learn()
        learn_seconds.append(time.perf_counter() - began - forecast_seconds[-1])
    return forecast_seconds[WARM:], learn_seconds[WARM:]


def _full(model: Any, moments: int) -> Any:
    """A place whose memory is full of moments at random."""
    from neurosym_jax.models.place import memory
    from neurosym_jax.models.place.place import Place

    place = Place(model, moments=moments)
    rng = np.random.default_rng(1)
    position = rng.uniform(-15, 15, (moments, 2))
    velocity = rng.normal(0, 1, (moments, 2))
    moment = np.concatenate([position, velocity, velocity], axis=1)
    time_of_step = model.config.period * np.arange(1, model.config.pred_len + 1)
    onward = velocity[:, None] * time_of_step[:, None]
    place._memory = memory.remember(
        memory.KERNELS,
        place._memory,
        moment.astype(np.float32),
        onward.astype(np.float32),
        np.zeros_like(onward, np.float32),
        np.arange(moments, dtype=np.int32),
        np.zeros(moments, np.float32),
    )
    return place
