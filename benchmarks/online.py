"""Latency of an online forecast: from a frame to everybody's 20 futures, people by people.

Frames come as fast as they are taken; a model of SGAN and one of NeuroSyM as described, with the
published sizes and random weights. The torch peer is given the finished window and does nothing but
forecast, so it is ahead of ours by what following people costs.
"""

import time
from typing import Any

import numpy as np

from benchmarks.light import decoding, encoding, limit, machine_rates
from benchmarks.timing import OURS, Row, row

PEOPLE = (2, 10, 50, 200)
FRAMES = 40
"""Forecasts for each repeat."""


def measure(options: Any) -> dict[str, Any]:
    """See the module."""
    from neurosym_jax.config import GeneratorConfig

    table: list[Row] = []
    configs = {
        "SGAN": GeneratorConfig(),
        "NeuroSyM": GeneratorConfig(pooling="as_described"),
    }
    stages, light = {}, {}
    rates = machine_rates()
    for people in PEOPLE:
        for name, config in configs.items():
            seconds = _ours(config, people, FRAMES * options.repeats)
            mine = row(f"{name}, {people} people", OURS, seconds, p99=_p99(seconds))
            work = encoding(config, people, people**2) + decoding(config, people, 20)
            stages[f"speed of light, {name}, {people} people"] = limit(work, rates, mine["median"])[
                "seconds"
            ]
            if (name, people) == ("NeuroSyM", 50):
                light = limit(work, rates, mine["median"])
            table.append(mine)
        if options.torch:
            seconds = _peer(people, FRAMES * options.repeats)
            ratio = float(np.median(seconds)) / table[-2]["median"]
            case = f"SGAN, {people} people"
            table.append(row(case, "torch peer", seconds, p99=_p99(seconds), ratio=ratio))
    return {"title": "online latency", "rows": table, "light": light, "stages": stages}


def _p99(seconds: list[float]) -> float:
    return float(np.percentile(seconds, 99))


def _walks(people: int, frames: int) -> np.ndarray:
    """[frames, people, 2] metres."""
    rng = np.random.default_rng(0)
    start = rng.uniform(0, 20, (1, people, 2))
    return start + rng.normal(0, 0.3, (frames, people, 2)).cumsum(axis=0)


def _ours(config: Any, people: int, frames: int) -> list[float]:
    from neurosym_jax.online.predictor import Predictor

    predictor = Predictor(random_model(config), max_people=people, samples=20)
    found, ids = [], np.arange(people)
    for number, xy in enumerate(_walks(people, frames + config.obs_len + 10)):
        forecast = predictor.push(number * 0.4, ids, xy)
        if forecast is not None:
            found.append(forecast.latency)
    return found[-frames:]


def random_model(config: Any) -> Any:
    """A model of torch's initial weights, in kind."""
    import jax

    from neurosym_jax.forecast import Model
    from neurosym_jax.models import Generator
    from neurosym_jax.scene import make_scene

    scene = make_scene(np.zeros((1, config.obs_len, 2)))
    alpha = np.zeros((1, 1, config.obs_len))
    shapes = jax.eval_shape(
        Generator(config).init, jax.random.key(0), scene, np.zeros(config.noise_dim), alpha
    )
    rng = np.random.default_rng(0)
    params = jax.tree.map(
        lambda leaf: rng.normal(0, leaf.shape[0] ** -0.5, leaf.shape).astype(np.float32), shapes
    )
    return Model(config, params)


def _peer(people: int, frames: int) -> list[float]:
    import torch

    from benchmarks.torch_eval import Chunk, TorchForecaster
    from benchmarks.torch_peer import Generator

    peer = TorchForecaster(Generator(8)).forecast
    walks = torch.as_tensor(_walks(people, 16)).transpose(0, 1)
    found = []
    for _ in range(frames + 5):
        start = time.perf_counter()
        peer(Chunk(walks[:, :8], walks[:, 8:], [people]), 20).numpy()
        found.append(time.perf_counter() - start)
    return found[5:]
