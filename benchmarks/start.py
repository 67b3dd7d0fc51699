"""Seconds of whole processes, imports and compiling included, with and without compiled programs.

`first forecast` loads a model that ships and forecasts one scene of ten people;
`evaluate.py` evaluates one published checkpoint on its scene, or 20, where data and
checkpoints are given.

A robot's process has forty people at ten frames a second from when it can take them,
and the two models that ship for zara1 at 8 + 8; their observation alone lasts 2.8 s.
`start` compiles everything at first, `meanwhile` what forecasts four people, and the
rest beside the forecasts.
"""

import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

from benchmarks.timing import OURS, Row, peak_mb, row

ROOT = Path(__file__).resolve().parents[1]

FORECAST = """
import sys
import numpy as np
from neurosym_jax import load_model, predict
from neurosym_jax.runtime.process import enable_compilation_cache, tune
tune()
enable_compilation_cache()
predict(load_model(sys.argv[1]), np.cumsum(np.ones((10, 8, 2)) * 0.3, axis=1))
"""

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
from neurosym_robot.online.pairs import likely_events
from neurosym_robot.online.predictor import Predictor
models = load_models([Path(name) for name in sys.argv[2:]])
predictor = Predictor(models, compile=sys.argv[1])
analytics = Analytics(predictor)
likely = lambda forecast: [likely_events(forecast, model, 0.4) for model in models]
predictor.programs.add(likely)
ready = time.monotonic()
rng = np.random.default_rng(0)
at, velocity = rng.uniform(-8, 8, (40, 2)), rng.normal(0, 1, (40, 2))
first = everybody = None
latency, late = [], 0.0
for frame in range(3000):
    due = ready + frame / 10
    time.sleep(max(0.0, due - time.monotonic()))
    late = max(late, time.monotonic() - due)
    forecast = predictor.push(frame / 10, np.arange(40), at + frame / 10 * velocity)
    analytics.add(forecast)
    if forecast is not None and len(forecast.ids):
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
    models = [
        str(ROOT / f"checkpoints/{kind}_zara1_8") for kind in ("neurosym", "sgan")
    ]
    commands = {"imports": ["-c", "import neurosym_jax"]}
    commands["first forecast"] = ["-c", FORECAST, models[-1]]
    if options.data and options.checkpoints:
        evaluate = [str(ROOT / "evaluate.py"), "--data", str(options.data.resolve())]
        evaluate += [
            "--no-figures",
            "--no-collisions",
            "--json",
            "rows.json",
            "--model",
        ]
        published = sorted(map(str, options.checkpoints.resolve().glob("*/*_model.pt")))
        zara1 = [
            path
            for path in published
            if path.endswith("sgan-p-models/zara1_8_model.pt")
        ]
        commands["evaluate.py, a checkpoint"] = evaluate + zara1
        commands[f"evaluate.py, {len(published)} checkpoints"] = evaluate + published
    for when in ("start", "meanwhile"):
        commands[f"robot, {when}"] = ["-c", NODE, when, *models]
    table: list[Row] = []
    for case, command in commands.items():
        with tempfile.TemporaryDirectory() as cache:
            runs = [_process(command, cache) for _ in range(1 + options.repeats)]
        for kind, chosen in (("cold", runs[:1]), ("warm", runs[1:])):
            peak = max(run.pop("peak_mb") for run in chosen)
            for stage in chosen[0]:
                values = [run[stage] for run in chosen]
                table.append(row(f"{case}, {kind}{stage}", OURS, values, peak_mb=peak))
    return {"title": "whole processes", "rows": table}


def _process(command: list[str], cache: str) -> dict[str, float]:
    """Seconds of the whole, or of what a robot's process says, and the peak of memory in MB."""
    start = time.perf_counter()
    report, peak = Path(cache, "said"), 0.0
    process = subprocess.Popen(
        [sys.executable, *command],
        env={**os.environ, "XDG_CACHE_HOME": cache, "PYTHONPATH": str(ROOT)},
        cwd=cache,
        stdout=report.open("w"),
    )
    # The system keeps no figures of an ended process; its peak is reached before the
    # end.
    while (
        os.waitid(os.P_PID, process.pid, os.WEXITED | os.WNOHANG | os.WNOWAIT) is None
    ):
        peak = max(peak, _peak_so_far(process.pid))
        time.sleep(0.01)
    seconds = time.perf_counter() - start
    if process.wait():
        raise RuntimeError(f"{' '.join(command[:3])} failed")
    times = {"": seconds}
    if NODE in command:
        times = {
            f": {stage}": value
            for stage, value in json.loads(report.read_text()).items()
        }
    return {"peak_mb": peak, **times}


def _peak_so_far(process: int) -> float:
    try:
        return peak_mb(process)
    except StopIteration:  # It ended just now.
        return 0.0
