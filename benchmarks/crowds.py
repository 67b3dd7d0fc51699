"""Seconds and memory of 20 forecasts of 200 to 10,000 people in a scene, each in its own process.

People are as dense as on a busy square, one on 4 m². Seconds are of warm repeats; memory is the
device's peak, or on a CPU the process's.
"""

import json
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.timing import OURS, Row, peak_mb, row

PEOPLE = {"anchors_zara1_8": (200, 1000, 10_000), "sgan_zara1_8": (100, 1000)}
"""By model; SGAN looks at every pair, 10,000 people would take minutes."""


def measure(options: Any) -> dict[str, Any]:
    """See the module."""
    table: list[Row] = []
    for model, crowds in PEOPLE.items():
        for people in crowds:
            command = [sys.executable, "-m", "benchmarks.crowds", model, str(people)]
            folder, pipe = Path(__file__).parents[1], subprocess.PIPE
            done = subprocess.run(command, cwd=folder, check=True, stdout=pipe, text=True)
            seconds_by_case = json.loads(done.stdout)
            name = model.partition("_")[0]
            table.append(row(f"{name}, {people} people", OURS, **seconds_by_case))
    return {"title": "crowds", "rows": table}


def one(model: str, people: int) -> dict[str, Any]:
    """Seconds of three warm repeats, and the peak of memory in MB."""
    from neurosym_jax.forecasting.model import predict
    from neurosym_jax.forecasting.model_folder import load_model

    forecaster, draw, seconds = load_model(model), np.random.default_rng(0), []
    start, pace = (
        draw.uniform(0, 2 * people**0.5, (people, 1, 2)),
        draw.normal(0, 0.4, (people, 1, 2)),
    )
    observed = start + pace * np.arange(8)[:, None]
    for _ in range(4):
        began = time.perf_counter()
        predict(forecaster, observed, samples=20)
        seconds.append(time.perf_counter() - began)
    return {"values": seconds[1:], "peak_mb": peak_mb()}


if __name__ == "__main__":
    print(json.dumps(one(sys.argv[1], int(sys.argv[2]))))
