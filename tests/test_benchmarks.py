"""Benchmarks run as documented, and no count grows; timings, which are noise, are not tested."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]


def run(*arguments):
    return subprocess.run(
        [sys.executable, *map(str, arguments)],
        cwd=ROOT,
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )


@pytest.mark.slow
def test_a_benchmark_and_its_page(tmp_path):
    """The symbols of three implementations agree, or it fails."""
    path, page = tmp_path / "numbers.json", tmp_path / "page.md"
    done = run("-m", "benchmarks", "symbols", "--repeats", 1, "--json", path, "--page", page)
    assert done.returncode == 0, done.stderr
    (result,) = json.loads(path.read_text())["benchmarks"].values()
    assert {row["who"] for row in result["rows"]} >= {"neurosym_jax", "plain loop"}
    assert all(0 < row["low"] <= row["median"] <= row["high"] for row in result["rows"])
    text = page.read_text()
    assert text.startswith("# Benchmarks")
    assert "QTC and alpha" in text


@pytest.mark.slow
def test_no_count_of_programs_flops_or_bytes_has_grown():
    done = run("-m", "benchmarks.counts")
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout[done.stdout.rindex("{") :])
    baseline = json.loads((ROOT / "benchmarks/baseline.json").read_text())
    assert found.keys() == baseline.keys()
    # A hundredth, because versions of jax write the same arithmetic a little differently.
    grown = {name: found[name] for name in found if found[name] > 1.01 * baseline[name]}
    assert not grown, f"was {baseline}; if it must be: python -m benchmarks.counts --write"
