"""Programs, FLOPs and bytes do not grow unnoticed; timings, which are noise, are not tested."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]


@pytest.mark.slow
def test_no_count_has_grown():
    done = subprocess.run(
        [sys.executable, "-m", "benchmarks.counts"],
        cwd=ROOT,
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout[done.stdout.rindex("{") :])
    baseline = json.loads((ROOT / "benchmarks/baseline.json").read_text())
    assert found.keys() == baseline.keys()
    # A hundredth, because versions of jax write the same arithmetic a little differently.
    grown = {name: found[name] for name in found if found[name] > 1.01 * baseline[name]}
    assert not grown, f"was {baseline}; if it must be: python -m benchmarks.counts --write"
