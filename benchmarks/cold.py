"""Seconds of whole processes, imports and compiling included, with and without compiled programs.

`first forecast` loads a model that ships and forecasts one scene of ten people; `evaluate.py`
evaluates one published checkpoint on its scene, or 20, where data and checkpoints are given.
"""

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


def measure(options: Any) -> dict[str, Any]:
    """See the module."""
    shipped = sorted((ROOT / "checkpoints").glob("*/config.json"))[0].parent
    commands = {"imports": ["-c", "import neurosym_jax"]}
    commands["first forecast"] = ["-c", FORECAST, str(shipped)]
    if options.data and options.checkpoints:
        evaluate = [str(ROOT / "evaluate.py"), "--data", str(options.data.resolve())]
        evaluate += ["--no-figures", "--no-collisions", "--json", "rows.json", "--checkpoint"]
        models = sorted(map(str, options.checkpoints.resolve().glob("*/*_model.pt")))
        zara1 = [path for path in models if path.endswith("sgan-p-models/zara1_8_model.pt")]
        commands["evaluate.py, a checkpoint"] = evaluate + zara1
        commands[f"evaluate.py, {len(models)} checkpoints"] = evaluate + models
    table: list[Row] = []
    for case, command in commands.items():
        with tempfile.TemporaryDirectory() as cache:
            cold = [_process(command, cache)]
            warm = [_process(command, cache) for _ in range(options.repeats)]
        for kind, found in (("cold", cold), ("warm", warm)):
            seconds, peaks = zip(*found)
            table.append(row(f"{case}, {kind}", OURS, seconds, peak_mb=max(peaks)))
    return {"title": "whole processes", "rows": table}


def _process(command: list[str], cache: str) -> tuple[float, float]:
    """Seconds and the peak of memory in MB."""
    start = time.perf_counter()
    process = subprocess.Popen(
        [sys.executable, *command],
        env={**os.environ, "XDG_CACHE_HOME": cache, "PYTHONPATH": str(ROOT)},
        cwd=cache,
        stdout=subprocess.DEVNULL,
    )
    peak = 0.0
    # The system keeps no figures of an ended process; its peak is reached before the end.
    while os.waitid(os.P_PID, process.pid, os.WEXITED | os.WNOHANG | os.WNOWAIT) is None:
        peak = max(peak, _peak_so_far(process.pid))
        time.sleep(0.01)
    seconds = time.perf_counter() - start
    if process.wait():
        raise RuntimeError(f"{' '.join(command[:3])} failed")
    return seconds, peak


def _peak_so_far(process: int) -> float:
    try:
        return peak_mb(process)
    except StopIteration:  # It ended just now.
        return 0.0
