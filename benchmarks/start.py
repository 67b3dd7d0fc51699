"""Seconds from the start of a robot's process until people are forecast, and what it costs them.

Forty people at ten frames a second from when the process can take them, and the two models that
ship for zara1 at 8 + 8; their observation alone lasts 2.8 s. `start` compiles everything at first,
`meanwhile` what forecasts four people, and the rest beside the forecasts.
"""

import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

from benchmarks.timing import OURS, row

ROOT = Path(__file__).resolve().parents[1]

NODE = """
import json, sys, time
began = time.monotonic()
import numpy as np
from neurosym_jax.runtime.process import enable_compilation_cache, tune
tune()
enable_compilation_cache()
from pathlib import Path
from neurosym_robot.online.replay import Analytics
from neurosym_robot.online.predictor import load_models
from neurosym_robot.online.pairs import LikelyEvents
from neurosym_robot.online.predictor import Predictor
models = load_models([Path(name) for name in sys.argv[2:]])
predictor = Predictor(models, compile=sys.argv[1])
analytics, likely = Analytics(predictor), LikelyEvents.of(predictor)
ready = time.monotonic()
rng = np.random.default_rng(0)
at, velocity = rng.uniform(-8, 8, (40, 2)), rng.normal(0, 1, (40, 2))
first = everybody = None
latency, late = [], 0.0
for frame in range(400):
    due = ready + frame / 10
    time.sleep(max(0.0, due - time.monotonic()))
    late = max(late, time.monotonic() - due)
    forecast = predictor.push(frame / 10, np.arange(40), at + frame / 10 * velocity)
    analytics.add(forecast)
    if forecast is not None:
        latency.append(forecast.latency)
        first = first or time.monotonic()
        if len(forecast.ids) == 40:
            everybody = everybody or time.monotonic()
    if everybody and not predictor.programs.waiting and len(latency) > 20:
        break
print(json.dumps({
    "ready for people": ready - began, "somebody is forecast": first - began,
    "all forty are": everybody - began, "longest latency": max(latency), "latest frame": late,
}))
"""


def measure(options: Any) -> dict[str, Any]:
    """See the module."""
    models = [str(ROOT / f"checkpoints/{kind}_zara1_8") for kind in ("neurosym", "sgan")]
    table = []
    for when in ("start", "meanwhile"):
        with tempfile.TemporaryDirectory() as cache:
            runs = [_node(cache, when, models) for _ in range(1 + options.repeats)]
        for kind, found in (("cold", runs[:1]), ("warm", runs[1:])):
            for case in runs[0]:
                values = [each[case] for each in found]
                table.append(row(f"{when}, {kind}: {case}", OURS, values))
    return {"title": "a robot's first forecasts", "rows": table}


def _node(cache: str, when: str, models: list[str]) -> dict[str, float]:
    done = subprocess.run(
        [sys.executable, "-c", NODE, when, *models],
        env={**os.environ, "XDG_CACHE_HOME": cache, "PYTHONPATH": str(ROOT)},
        stdout=subprocess.PIPE,
        check=True,
    )
    return json.loads(done.stdout)
