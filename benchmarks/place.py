"""What a place costs a robot: a frame of sixty people, with and without what was learned.

People walk at random, ten frames a second. Measured is the time from a frame to the
draws of everybody, and then that of learning, which comes after. Each frame is forecast
without the memory and with it, one after the other, so that what else the machine does
falls on both. The memory is full: a hundred thousand moments at random, where people
walk.
"""

import time
from typing import Any, NamedTuple

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
    moments = 0, MOMENTS
    costs = apart(_frames, moments, FRAMES * options.repeats)
    table: list[Row] = []
    for number, cost in zip(moments, costs):
        place = f"{number:,} moments" if number else "no place"
        table.append(_row(f"{PEOPLE} people, {place}, to the draws", cost.draws))
        if number:
            table.append(_row(f"{PEOPLE} people, {place}, learning", cost.learning))
    return {"title": "a frame where a place is watched", "rows": table}


class Cost(NamedTuple):
    """What frames cost: [n, 2] seconds of the clock and of the processor."""

    draws: np.ndarray
    """Up to the draws of everybody."""
    learning: np.ndarray
    """After them."""


def _row(case: str, seconds: np.ndarray) -> Row:
    wall, cpu = seconds.T
    cpu_median, p99 = float(np.median(cpu)), float(np.percentile(wall, 99))
    return row(case, OURS, wall.tolist(), cpu=cpu_median, p99=p99)


def _frames(moments: tuple[int, ...], frames: int) -> list[Cost]:
    """The costs of the same frames with places of so many moments, in turns."""
    from neurosym_jax.models.disk import find_model, load_model
    from neurosym_robot.online.predictor import Predictor

    model = load_model(find_model(MODEL))
    predictors, costs = [], []
    for number in moments:
        place = _full(model, number) if number else None
        predictors.append(Predictor(model, max_people=PEOPLE, place=place))
        costs.append(Cost(np.zeros((frames, 2)), np.zeros((frames, 2))))
    rng = np.random.default_rng(0)
    position = rng.uniform(-10, 10, (PEOPLE, 2))
    velocity = rng.normal(0, 1, (PEOPLE, 2))
    for frame in range(-WARM, frames):
        velocity += rng.normal(0, 0.05, velocity.shape)
        position = position + 0.1 * velocity
        for predictor, cost in zip(predictors, costs):
            began = _clocks()
            predictor.window.push(frame / 10, np.arange(PEOPLE), position)
            for result in predictor.forecast().models.values():
                result.draws  # noqa: B018
            drawn = _clocks()
            predictor.learn()
            if frame >= 0:
                cost.draws[frame] = drawn - began
                cost.learning[frame] = _clocks() - drawn
    return costs


def _clocks() -> np.ndarray:
    return np.array([time.perf_counter(), time.process_time()])


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
