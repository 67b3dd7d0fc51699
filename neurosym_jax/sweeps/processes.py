"""Runs of a sweep in processes of one thread each, their words in a log of each run.

A process trains one run after another (`worker`): it has its modules imported and the programs of a
network compiled when the next seed begins. Where one dies, the run that it was at has failed, and
another process goes on with the rest.
"""

import contextlib
import json
import os
import selectors
import subprocess
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path

from neurosym_jax.sweeps.runs import SweepRun

__all__ = ["LOG", "TrainingProcess", "last_line", "start", "train_runs"]

LOG = "train.log"
FINISHED = "0\n"
"""The answer to a run that came to its end."""
ONE_THREAD = {"NPROC": "1"}
"""As fast at these sizes, and the same bits wherever it runs."""


def train_runs(runs: Sequence[SweepRun], at_once: int) -> Iterator[tuple[SweepRun, bool]]:
    """Each run when it ends, with whether it came to its end; `at_once` are trained at a time."""
    waiting = list(reversed(runs))
    working: dict[TrainingProcess, SweepRun] = {}
    with selectors.DefaultSelector() as answers:

        def begin(worker: TrainingProcess | None) -> None:
            """Train the next run, by a new process where there is none."""
            if waiting:
                if worker is None:
                    worker = TrainingProcess()
                    answers.register(worker.answers, selectors.EVENT_READ, worker)
                working[worker] = run = waiting.pop()
                worker.train(run)

        try:
            for _ in range(min(at_once, len(waiting))):
                begin(None)
            while working:
                for key, _ in answers.select():
                    worker = key.data
                    answer, run = worker.answers.readline(), working.pop(worker)
                    if not answer:
                        answers.unregister(worker.answers)
                        worker.tell_its_end(run)
                    begin(worker if answer else None)
                    yield run, answer == FINISHED
        finally:
            for key in list(answers.get_map().values()):
                key.data.end()


def start(run: SweepRun) -> subprocess.Popen:
    """Begin the run in a process of its own, or go on with it."""
    run.folder.mkdir(parents=True, exist_ok=True)
    with (run.folder / LOG).open("a") as log:
        return subprocess.Popen(
            [sys.executable, "-m", "neurosym_jax", "train", *run.arguments],
            stdout=log,
            stderr=subprocess.STDOUT,
            env={**os.environ, **ONE_THREAD},
        )


def last_line(run: SweepRun) -> str:
    """Of the run's log: why it failed."""
    log = run.folder / LOG
    if not log.exists():
        return f"there is no {log}: do all that train see this folder?"
    lines = log.read_text().split("\n")
    return next((line for line in reversed(lines) if line.strip()), "no word of why")


class TrainingProcess:
    """A process that trains what it is sent, one run after another, and answers each time."""

    def __init__(self, folder: Path | None = None):
        """Start it, in the working folder of the sweep where that is not this process's."""
        self._folder = folder or Path()
        self._process = subprocess.Popen(
            [sys.executable, "-m", "neurosym_jax.sweeps.worker"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            env={**os.environ, **ONE_THREAD},
            cwd=folder,
        )
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._runs, self.answers = self._process.stdin, self._process.stdout

    def train(self, run: SweepRun) -> None:
        """Begin `run`; when it ends there is a line in `answers`, nothing if the process dies."""
        log = self._log(run)
        log.parent.mkdir(parents=True, exist_ok=True)
        with contextlib.suppress(BrokenPipeError):  # It has died: there will be no answer.
            self._runs.write(json.dumps([str(log), *run.arguments]) + "\n")
            self._runs.flush()

    def train_to_the_end(self, run: SweepRun) -> bool | None:
        """Whether it came to its end; None where the process has died, which the log is told."""
        self.train(run)
        answer = self.answers.readline()
        if not answer:
            self.tell_its_end(run)
            return None
        return answer == FINISHED

    def tell_its_end(self, run: SweepRun) -> None:
        """Tell the log of `run` how the process ended."""
        status = self.end()
        with self._log(run).open("a") as log:
            log.write(f"its process ended with status {status}\n")

    def end(self) -> int:
        """Stop it, unless it has died; its exit status."""
        self.stop()
        for pipe in (self._runs, self.answers):
            with contextlib.suppress(BrokenPipeError):
                pipe.close()
        return self._process.returncode

    def stop(self) -> None:
        """Stop it, whoever waits for its answer."""
        self._process.terminate()
        self._process.wait()

    def _log(self, run: SweepRun) -> Path:
        return self._folder / run.folder / LOG
