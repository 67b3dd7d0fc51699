"""A run of a sweep as a process: `neurosym train` with one thread, its words in a log."""

import os
import subprocess
import sys

from neurosym_jax.sweeps.runs import SweepRun

__all__ = ["last_line", "start"]

LOG = "train.log"


def start(run: SweepRun) -> subprocess.Popen:
    """Begin the run, or go on with it."""
    run.folder.mkdir(parents=True, exist_ok=True)
    with (run.folder / LOG).open("a") as log:
        return subprocess.Popen(
            [sys.executable, "-m", "neurosym_jax", "train", *run.arguments],
            stdout=log,
            stderr=subprocess.STDOUT,
            # One thread each: as fast at these sizes, and the same bits wherever it runs.
            env={**os.environ, "NPROC": "1"},
        )


def last_line(run: SweepRun) -> str:
    """Of the run's log: why it failed."""
    lines = (run.folder / LOG).read_text().split("\n")
    return next((line for line in reversed(lines) if line.strip()), "no word of why")
