"""The tests of numbers on this machine's device: symbols, networks, stored forecasts, parity."""

import re
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

from benchmarks.timing import OURS, row

TESTS = (
    "symbolic",
    "models",
    "forecasting",
    "interop/test_parity.py",
    "test_golden.py",
)


def measure(options: Any) -> dict[str, Any]:
    """See the module; what failed is printed, and counted in the row."""
    tests = [f"tests/{name}" for name in TESTS]
    start = time.perf_counter()
    done = subprocess.run(
        [sys.executable, "-m", "pytest", "-n", "0", "-p", "no:cacheprovider", *tests],
        cwd=Path(__file__).parents[1],
        capture_output=True,
        text=True,
        check=False,
    )
    seconds = time.perf_counter() - start
    failed = [
        line
        for line in done.stdout.splitlines()
        if line.startswith(("FAILED", "ERROR"))
    ]
    print("\n".join(failed or [done.stderr]))
    counts = re.findall(r"\d+ (?:passed|failed|skipped|errors?)\b", done.stdout[-400:])
    return {
        "title": "tests of numbers",
        "rows": [row(", ".join(counts), OURS, [seconds])],
    }
