"""The benchmarks run as documented; what they say of the machine is not tested."""

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
def test_what_is_missing_is_said():
    done = run("-m", "benchmarks", "zoo")
    assert done.returncode == 2
    assert done.stderr == "error: --data is needed for zoo\n"
