"""Latency of an online forecast: from a frame's arrival to 20 futures of all people.

Ten frames a second of people walking at random through a square, as fast as they can be
pushed; the models that ship for zara1 at 8 + 8, each alone. Measured is
`Forecast.latency`: window, forecast, mean and most central sample. The torch peer is
given the finished window and does nothing but forecast, so it is ahead of ours by what
following people costs.
"""

import time
from typing import Any

import numpy as np

from benchmarks.light import decoding, encoding, limit, machine_rates
from benchmarks.timing import OURS, Row, apart, row

PEOPLE = (2, 10, 50, 200)
FORECASTS = 100
"""For each repeat."""
WARM = 20
"""Forecasts that are not counted: the first ones fill caches."""
MODELS = {
    "SGAN": "sgan_zara1_8",
    "NeuroSyM": "neurosym_zara1_8",
    "anchors": "anchors_zara1_8",
}


def measure(options: Any) -> dict[str, Any]:
    """See the module."""
    from neurosym_jax.models.disk import load_model

    table: list[Row] = []
    stages, light = {}, {}
    rates, count = machine_rates(), FORECASTS * options.repeats
    for people in PEOPLE:
        medians = {}
        for name, folder in MODELS.items():
            model = load_model(folder)
            seconds = apart(_ours, model, people, count)
            mine = row(f"{name}, {people} people", OURS, seconds, p99=_p99(seconds))
            medians[name] = mine["median"]
            table.append(mine)
            if name == "anchors":
                continue
            work = encoding(model.config, people, people**2)
            work += decoding(model.config, people, 20)
            least = limit(work, rates, mine["median"])
            stages[f"speed of light, {name}, {people} people"] = least["seconds"]
            if (name, people) == ("NeuroSyM", 50):
                light = least
        if options.torch:
            seconds = apart(_peer, people, FORECASTS)
            ratio = float(np.median(seconds)) / medians["SGAN"]
            case = f"SGAN, {people} people"
            table.append(
                row(case, "torch peer", seconds, p99=_p99(seconds), ratio=ratio)
            )
    return {"title": "online latency", "rows": table, "light": light, "stages": stages}


def _p99(seconds: list[float]) -> float:
    return float(np.percentile(seconds, 99))


def _ours(model: Any, people: int, forecasts: int) -> list[float]:
    from neurosym_robot.online.predictor import Predictor

    predictor = Predictor(model, samples=20, max_people=people)
    rng = np.random.default_rng(0)
    position = rng.uniform(0, 2 * people**0.5, (people, 2))
    velocity = rng.normal(0, 1.0, (people, 2))
    ids, seconds, frame = np.arange(people), [], 0
    while len(seconds) < forecasts + WARM:
        velocity += rng.normal(0, 0.05, velocity.shape)
        position = position + 0.1 * velocity
        forecast = predictor.push(frame / 10, ids, position)
        frame += 1
        if forecast is not None:
            seconds.append(forecast.latency)
    return seconds[WARM:]


def _peer(people: int, forecasts: int) -> list[float]:
    import torch

    from benchmarks.torch_peer import Chunk, Generator, TorchForecaster

    peer = TorchForecaster(Generator(8)).forecast
    walks = torch.randn(people, 16, 2).cumsum(1)
    seconds = []
    for _ in range(forecasts + WARM):
        start = time.perf_counter()
        peer(Chunk(walks[:, :8], walks[:, 8:], [people]), 20).numpy()
        seconds.append(time.perf_counter() - start)
    return seconds[WARM:]
