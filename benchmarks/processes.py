"""A step of training by one process and by two, see docs/scaling.md; one thread each.

The processes are those that a person starts, `train.py` on zara1 (SGAN, 8 + 8 steps), and steps are
timed by the rows that they write, of 25 steps each; compiling lies before the first. One run each,
one after the other.
"""

import itertools
import os
import socket
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

from benchmarks.timing import row
from neurosym_jax.training.loop import CHUNK

ROOT = Path(__file__).resolve().parents[1]
ROWS = 5

CONTESTANTS = {
    "one process": (1, 1),
    "one process, two shards": (1, 2),
    "two processes, two shards": (2, 2),
}
"""How many processes, how many shards."""


def measure(options: Any) -> dict[str, Any]:
    """See the module."""
    table = []
    for scenes in (64, 512):
        command = [sys.executable, str(ROOT / "train.py"), "--scene", "zara1", "--data"]
        command += [str(options.need("data").resolve())]
        command += [
            "--steps",
            str(CHUNK * ROWS),
            "--set",
            f"batch_scenes={scenes}",
        ]
        for who, (processes, shards) in CONTESTANTS.items():
            with tempfile.TemporaryDirectory() as folder:
                arguments = [*command, f"shards={shards}", "--out", folder]
                seconds = _seconds_a_row(arguments, Path(folder), processes)
            table.append(row(f"{scenes} scenes a step", who, [each / CHUNK for each in seconds]))
    return {"title": "A step of training by one process and by two", "rows": table}


def _seconds_a_row(command: list[str], folder: Path, processes: int) -> list[float]:
    """Between the rows of `metrics.jsonl`, the first and the last (a validation) left out."""
    together = [[]]
    if processes > 1:
        with socket.socket() as free:
            free.bind(("127.0.0.1", 0))
            address = f"127.0.0.1:{free.getsockname()[1]}"
        joined = ["--processes.coordinator", address, "--processes.count", str(processes)]
        together = [[*joined, "--processes.index", str(index)] for index in range(processes)]
    running = [
        subprocess.Popen(
            [*command, *each],
            env={**os.environ, "NPROC": "1"},
            stdout=subprocess.DEVNULL,
        )
        for each in together
    ]
    log, seen = folder / "metrics.jsonl", []
    try:
        while None in (codes := [process.poll() for process in running]) and not any(codes):
            rows = log.read_text().count("\n") if log.exists() else 0
            seen += [time.perf_counter()] * (rows - len(seen))
            time.sleep(0.002)
    finally:
        for process in running:
            process.kill()
    if any(codes):
        raise RuntimeError(f"train.py ended with {codes}")
    return [after - before for before, after in itertools.pairwise(seen[:-1])]
