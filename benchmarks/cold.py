"""Seconds of whole processes, imports and compiling included, with and without compiled programs.

`first forecast` loads a model that ships and forecasts one scene of ten people; `evaluate.py`
evaluates one published checkpoint on its scene, or 20, where data and checkpoints are given.
"""

import os
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

from benchmarks.timing import OURS, Row, row

ROOT = Path(__file__).resolve().parents[1]

FORECAST = """
import sys
import numpy as np
from neurosym_jax import load_model, predict
from neurosym_jax.runtime import enable_compilation_cache
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
        for kind, seconds in (("cold", cold), ("warm", warm)):
            peak = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss / 1024
            table.append(row(f"{case}, {kind}", OURS, seconds, peak_mb=peak))
    return {"title": "whole processes", "rows": table}


def _process(command: list[str], cache: str) -> float:
    start = time.perf_counter()
    subprocess.run(
        [sys.executable, *command],
        env={**os.environ, "XDG_CACHE_HOME": cache, "PYTHONPATH": str(ROOT)},
        cwd=cache,
        check=True,
        stdout=subprocess.DEVNULL,
    )
    return time.perf_counter() - start
