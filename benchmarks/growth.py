"""How time and memory grow with agents in a scene, samples, and windows; each in its own process.

SGAN with pooling and random weights, in a crowd the recommended model, with one person on four
square metres; seconds are of a warm repeat, memory is the process's peak.
"""

import json
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.timing import OURS, Row, peak_mb, row

POINTS = {
    "agents": (2, 10, 100, 1000),
    "crowd": (100, 1000, 10_000),
    "samples": (1, 10, 100, 1000),
    "windows": (10, 1000, 100_000, 1_000_000),
}


def measure(options: Any) -> dict[str, Any]:
    """See the module."""
    table: list[Row] = []
    for axis, points in POINTS.items():
        for point in points:
            done = subprocess.run(
                [sys.executable, "-m", "benchmarks.growth", axis, str(point)],
                cwd=Path(__file__).resolve().parents[1],
                check=True,
                capture_output=True,
                text=True,
            )
            found = json.loads(done.stdout)
            table.append(row(f"{axis} {point}", OURS, found["seconds"], peak_mb=found["peak_mb"]))
    return {"title": "growth", "rows": table}


def one(axis: str, point: int) -> dict[str, Any]:
    """Seconds of warm repeats and the process's peak memory in MB."""
    from neurosym_jax.data.batching import make_batches
    from neurosym_jax.data.windows import Windows
    from neurosym_jax.evaluation.metrics import metric_names
    from neurosym_jax.evaluation.scoring import score_forecaster
    from neurosym_jax.forecasting.model import predict
    from neurosym_jax.forecasting.model_folder import load_model
    from neurosym_jax.models.config import GeneratorConfig

    model = _random_model(GeneratorConfig())
    rng = np.random.default_rng(0)
    seconds = []
    if axis == "windows":
        # Scenes of four people, so that the count alone grows.
        sizes = np.full(point // 4 + 1, 4)
        windows = Windows(
            position=rng.normal(0, 0.3, (sizes.sum(), 16, 2)).cumsum(axis=1),
            agent=np.arange(sizes.sum()),
            bounds=np.concatenate([[0], np.cumsum(sizes)]),
            identity=np.stack([np.zeros(len(sizes)), np.arange(len(sizes))], 1).astype(np.uint32),
            obs_len=8,
        )
        metrics = metric_names(collisions=False)
        arguments: dict[str, Any] = {"samples": 20, "seed": 0, "metrics": metrics}
        for _ in range(3):
            start = time.perf_counter()
            score_forecaster(model.forecaster, model.params, make_batches(windows), **arguments)
            seconds.append(time.perf_counter() - start)
    else:
        agents, samples = (10, point) if axis == "samples" else (point, 20)
        side = 20.0
        if axis == "crowd":
            model, side = load_model("anchors_general_12"), 2 * agents**0.5
        observed = rng.uniform(0, side, (agents, 1, 2)) + np.zeros((1, 8, 1))
        for _ in range(4):
            start = time.perf_counter()
            predict(model, observed, samples=samples)
            seconds.append(time.perf_counter() - start)
    return {"seconds": seconds[1:], "peak_mb": peak_mb()}


def _random_model(config: Any) -> Any:
    """A model of torch's initial weights, in kind."""
    import jax

    from neurosym_jax.forecasting.model import Model
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


if __name__ == "__main__":
    print(json.dumps(one(sys.argv[1], int(sys.argv[2]))))
