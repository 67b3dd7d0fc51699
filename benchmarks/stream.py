"""A stream of a hundred thousand scenes: scenes a second, and the memory that it takes.

Scenes of one to eight people who walk at random are made as they are asked for; 20
samples of each are forecast and dropped. The torch peer is given the same scenes, 112
together, which are about as many people as it is fastest with.
"""

import itertools
import time
from collections.abc import Iterator
from typing import Any

import numpy as np

from benchmarks.timing import OURS, Row, apart, peak_mb, row

MODELS = {"SGAN": "sgan_zara1_8", "anchors": "anchors_zara1_8"}
SCENES, WARM, PEER = 100_000, 1024, 112
LARGEST = 8
"""People in a scene."""


def measure(options: Any) -> dict[str, Any]:
    """See the module."""
    table: list[Row] = []
    for name, model in MODELS.items():
        seconds, memory = apart(_ours, model)
        case = f"{name}, a stream of {SCENES} scenes"
        table.append(row(case, OURS, [seconds], peak_mb=memory))
        if options.torch and name == "SGAN":
            theirs, memory = apart(_peer)
            ratio = theirs / seconds
            table.append(row(case, "torch peer", [theirs], peak_mb=memory, ratio=ratio))
    return {"title": "stream", "rows": table}


def walks(count: int) -> Iterator[np.ndarray]:
    """`count` scenes [N, 8, 2] in metres."""
    rng = np.random.default_rng(0)
    for _ in range(count):
        people = rng.integers(1, LARGEST + 1)
        start = rng.uniform(0, 4, (people, 1, 2))
        yield start + rng.normal(0, 0.3, (people, 8, 2)).cumsum(axis=1)


def _ours(model: str) -> tuple[float, float]:
    """Seconds of the whole stream, programs compiled, and the peak of memory in MB."""
    from neurosym_jax.models.disk import load_model
    from neurosym_jax.models.forecast import predict_batches

    forecaster = load_model(model)
    for _ in predict_batches(walks(WARM), forecaster):
        pass
    began = time.perf_counter()
    for _ in predict_batches(walks(SCENES), forecaster):
        pass
    return time.perf_counter() - began, peak_mb()


def _peer() -> tuple[float, float]:
    import torch

    from benchmarks.torch_peer import Chunk, Generator, TorchForecaster

    peer = TorchForecaster(Generator(8)).forecast
    began, stream = time.perf_counter(), walks(SCENES)
    for scenes in iter(lambda: list(itertools.islice(stream, PEER)), []):
        observed = torch.tensor(np.concatenate(scenes), dtype=torch.float32)
        peer(Chunk(observed, observed, [len(scene) for scene in scenes]), 20).numpy()
    return time.perf_counter() - began, peak_mb()
