"""Runs of a sweep on the workers of a cluster: each of their threads has a process that trains.

All see the working folder of the sweep under the same path. A process ends with the worker that
began it, and another worker goes on with its run where that was last saved.
"""

import functools
import os
import threading
import uuid
from collections.abc import Iterator, Sequence
from pathlib import Path

from neurosym_jax.runtime.cluster import over_cluster
from neurosym_jax.sweeps.processes import LOG, TrainingProcess
from neurosym_jax.sweeps.runs import SweepRun
from neurosym_jax.training.lock import wait_for_others

__all__ = ["train_over_cluster"]

_processes: dict[tuple[str, int], TrainingProcess] = {}
"""Of a worker, by sweep and thread."""
_ended: set[str] = set()
"""Sweeps of which nothing more is to begin on a worker."""

_Item = tuple[str, Path, SweepRun]


def train_over_cluster(runs: Sequence[SweepRun], address: str) -> Iterator[tuple[SweepRun, bool]]:
    """Each run when it ends, with whether it came to its end, as `train_runs`.

    Raises:
        InputError: as `over_cluster`.
    """
    sweep = uuid.uuid4().hex
    items: list[_Item] = [(sweep, Path.cwd(), run) for run in runs]
    end = functools.partial(_end, sweep)
    for place, finished, reason in over_cluster(address, _train, items, afterwards=end):
        run = runs[place]
        if reason:
            run.folder.mkdir(parents=True, exist_ok=True)
            with (run.folder / LOG).open("a") as log:
                log.write(f"{reason}\n")
        yield run, bool(finished)


def _train(item: _Item) -> bool:
    """On a worker."""
    sweep, folder, run = item
    os.stat(folder)  # What is not there is told by its name.
    # A worker that has just died may have left a process that has not ended yet.
    wait_for_others(folder / run.folder, seconds=10)
    key = sweep, threading.get_ident()
    if sweep in _ended:
        return False
    if key not in _processes:
        _processes[key] = TrainingProcess(folder)
    finished = _processes[key].train_to_the_end(run)
    if finished is None:
        _processes.pop(key, None)
    return bool(finished)


def _end(sweep: str) -> None:
    """On a worker: what it has begun for the sweep."""
    _ended.add(sweep)
    for key in [key for key in _processes if key[0] == sweep]:
        _processes.pop(key).stop()
