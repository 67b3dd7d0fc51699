"""How long a sweep will take, from the first steps of one of its runs."""

import dataclasses
import json
import tempfile
import time
from pathlib import Path

from neurosym_jax.errors import InputError
from neurosym_jax.sweeps.processes import last_line, start
from neurosym_jax.sweeps.runs import SweepRun

__all__ = ["seconds_of_run"]

ROWS = 3
"""Of `metrics.jsonl` that are waited for: the first comes after reading and compiling."""


def seconds_of_run(run: SweepRun) -> float:
    """What `run` will take, about: started in a folder that is thrown away, for a few steps.

    Validations are left out, and runs side by side slow each other down.

    Raises:
        InputError: where the run fails.
    """
    with tempfile.TemporaryDirectory() as folder:
        trial = dataclasses.replace(
            run, folder=Path(folder), arguments=(*run.arguments, "--out", folder)
        )
        process, began = start(trial), time.monotonic()
        try:
            times, steps = _first_rows(trial, process)
        finally:
            process.terminate()
            process.wait()
    per_step = (times[-1] - times[0]) / max(steps[-1] - steps[0], 1)
    return times[0] - began + per_step * (run.recipe.steps - steps[0])


def _first_rows(run: SweepRun, process) -> tuple[list[float], list[int]]:
    """When the first rows came, and their steps."""
    path, times, steps = run.folder / "metrics.jsonl", [], []
    while len(times) < ROWS:
        ended = process.poll() is not None
        lines = path.read_text().split("\n")[:-1] if path.exists() else []
        for line in lines[len(times) : ROWS]:
            times.append(time.monotonic())
            steps.append(json.loads(line)["step"])
        if ended:
            if not times:
                raise InputError(f"the run fails: {last_line(run)}")
            break
        time.sleep(0.02)
    return times, steps
