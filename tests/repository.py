"""The repository's folders, processes of Python that start in it, and cases for releases."""

import functools
import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
GOLDEN = ROOT / "tests" / "golden"
SMALL = GOLDEN / "small.pt"
"""A checkpoint of SGAN with few parameters, as torch saves it."""
slow = functools.partial(pytest.param, marks=pytest.mark.slow)
"""A case that takes seconds."""
exhaustive = functools.partial(pytest.param, marks=pytest.mark.exhaustive)
"""A case that a release runs, because another has most of its faults in less time."""


def run_python(*words, cwd=ROOT, check=True, **environment):
    """Run `python WORDS` with these changes to the environment: its status and what it wrote."""
    done = subprocess.run(
        [sys.executable, *map(str, words)],
        cwd=cwd,
        env=os.environ | environment,
        capture_output=True,
        text=True,
    )
    assert not check or done.returncode == 0, done.stdout + done.stderr
    return done
