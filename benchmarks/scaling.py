"""How seconds and memory grow with people, draws and checkpoints.

Forecasts, of 20 samples or of draws from the distribution, are of a scene as dense as a
busy square, one person on 4 m²; seconds are of warm repeats, memory is the device's
peak, or on a CPU the process's. Checkpoints are copies of one that ships, a whole
`evaluate.py` from its start to its report, on the bundled recording, or on zara1 where
there is `--data`. An exponent is of the last two sizes: seconds grow with its power of
the size.
"""

import itertools
import json
import math
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.timing import OURS, Row, peak_mb, row

ROOT = Path(__file__).resolve().parents[1]
MODELS = {"anchors": "anchors_zara1_8", "SGAN": "sgan_zara1_8"}
PEOPLE = 10, 100, 1000, 10_000
DRAWS, IN_SCENE = (1, 20, 200), 100
CHECKPOINTS = (1, 10, 100)


def measure(options: Any) -> dict[str, Any]:
    """See the module."""
    table: list[Row] = []
    for name, model in MODELS.items():
        found = [(people, _apart(model, people, 0)) for people in PEOPLE]
        table += _rows(f"{name}, 20 samples, people", found)
        found = [(draws, _apart(model, IN_SCENE, draws)) for draws in DRAWS]
        table += _rows(f"{name}, {IN_SCENE} people, draws", found)
    source = ["--data", str(options.data.resolve())] if options.data else []
    with tempfile.TemporaryDirectory() as folder:
        names = [f"copy_{number}" for number in range(max(CHECKPOINTS))]
        for name in names:
            shutil.copytree(ROOT / "checkpoints" / MODELS["SGAN"], Path(folder, name))
        command = [sys.executable, str(ROOT / "evaluate.py"), *source, "--no-figures"]
        found = []
        for count in CHECKPOINTS:
            arguments = [
                *command,
                "--json",
                "rows.json",
                "--model",
                *names[:count],
            ]
            seconds = []
            for _ in range(3):
                began = time.perf_counter()
                subprocess.run(arguments, cwd=folder, check=True, capture_output=True)
                seconds.append(time.perf_counter() - began)
            found.append((count, {"values": seconds[1:]}))
    table += _rows("whole command, SGAN, checkpoints", found)
    return {"title": "scaling", "rows": table}


def _apart(model: str, people: int, draws: int) -> dict[str, Any]:
    """What `one` finds in a process of its own."""
    command = [
        sys.executable,
        "-m",
        "benchmarks.scaling",
        model,
        str(people),
        str(draws),
    ]
    done = subprocess.run(command, cwd=ROOT, check=True, capture_output=True, text=True)
    return json.loads(done.stdout)


def _rows(title: str, found: list[tuple[int, dict[str, Any]]]) -> list[Row]:
    table = [
        row(f"{title}: {size}", OURS, size=size, **values) for size, values in found
    ]
    for smaller, larger in itertools.pairwise(table):
        growth = larger["median"] / smaller["median"]
        larger["exponent"] = math.log(growth) / math.log(
            larger["size"] / smaller["size"]
        )
    return table


def one(model: str, people: int, draws: int) -> dict[str, Any]:
    """Seconds of three warm repeats, and the peak of memory in MB; without draws of samples."""
    from neurosym_jax.models.disk import load_model
    from neurosym_jax.models.forecast import predict, predict_distribution

    forecaster, draw, seconds = load_model(model), np.random.default_rng(0), []
    start = draw.uniform(0, 2 * people**0.5, (people, 1, 2))
    pace = draw.normal(0, 0.4, (people, 1, 2))
    observed = start + pace * np.arange(8)[:, None]
    for _ in range(4):
        began = time.perf_counter()
        if draws:
            predict_distribution(forecaster, observed, draws=draws)
        else:
            predict(forecaster, observed, samples=20)
        seconds.append(time.perf_counter() - began)
    return {"values": seconds[1:], "peak_mb": peak_mb()}


if __name__ == "__main__":
    print(json.dumps(one(sys.argv[1], int(sys.argv[2]), int(sys.argv[3]))))
