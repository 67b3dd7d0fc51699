"""The tests of numbers on this machine's device: symbols, networks, stored forecasts, parity."""

import re
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

from benchmarks.timing import OURS, row
from neurosym_jax.errors import InputError
from neurosym_jax.runtime.process import cpu_cores

TESTS = ("symbolic", "models", "interop/test_parity.py", "test_golden.py")
ALL_PASSED, SOME_FAILED = 0, 1  # what pytest returns if it ran tests
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
        "rows": [row(", ".join(counts), OURS, [seconds])],
    }
