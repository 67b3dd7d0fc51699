"""Numbers on this machine's device: forecasts beside the CPU's, and the tests of numbers.

Those are of symbols, networks, stored forecasts and parity.
"""

import re
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.timing import OURS, Row, apart, row
from neurosym_jax.errors import InputError
from neurosym_jax.runtime.process import cpu_cores

TESTS = ("symbolic", "models", "interop/test_parity.py", "test_golden.py")
ALL_PASSED, SOME_FAILED = 0, 1  # what pytest returns if it ran tests
MODELS, PEOPLE = ("sgan_zara1_8", "neurosym_zara1_8", "anchors_zara1_8"), 10
WORKERS = 8  # at most; each compiles programs of its own


def measure(options: Any) -> dict[str, Any]:
    """See the module; what failed is printed, and counted in the row."""
    workers = str(min(WORKERS, cpu_cores()))
    command = [sys.executable, "-m", "pytest", "-p", "no:cacheprovider"]
    command += ["-n", workers, "--maxprocesses", workers]
    command += [f"tests/{name}" for name in TESTS]
    start = time.perf_counter()
    done = subprocess.run(
        command,
        cwd=Path(__file__).parents[1],
        capture_output=True,
        text=True,
        check=False,
    )
    seconds = time.perf_counter() - start
    if done.returncode not in (ALL_PASSED, SOME_FAILED):
        raise InputError(f"no test was run: {done.stderr or done.stdout}")
    failed = [
        line
        for line in done.stdout.splitlines()
        if line.startswith(("FAILED", "ERROR"))
    ]
    print("\n".join(failed))
    counts = re.findall(r"\d+ (?:passed|failed|skipped|errors?)\b", done.stdout[-400:])
    return {
        "title": "tests of numbers",
        "rows": [row(", ".join(counts), OURS, [seconds]), *apart(_differences)],
    }


def _differences() -> list[Row]:
    """How far forecasts are at most from those on the CPU, metres."""
    import jax

    from neurosym_jax.models.disk import load_model
    from neurosym_jax.models.forecast import predict

    draw = np.random.default_rng(0)
    start = draw.uniform(0, 10, (PEOPLE, 1, 2))
    pace = draw.normal(0, 0.4, (PEOPLE, 1, 2))
    observed = start + pace * np.arange(8)[:, None]
    table = []
    for name in MODELS:
        model = load_model(name)
        here = predict(model, observed, samples=20)
        with jax.default_device(jax.devices("cpu")[0]):
            beside = predict(model, observed, samples=20)
        difference = float(np.abs(here - beside).max())
        case = f"{name}, difference from the CPU"
        table.append(row(case, OURS, [difference], "m"))
    return table
