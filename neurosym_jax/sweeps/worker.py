"""A process that trains one run of a sweep after another: `python -m neurosym_jax.sweeps.worker`.

Of each line it reads, `[LOG, ARGUMENT, ...]` as JSON, it calls `neurosym train ARGUMENT ...`, whose
words go to the end of LOG; then it prints a line, the exit status. It ends with its parent, in the
middle of a run too, so that another may go on with that.
"""

import json
import os
import sys
import threading
import traceback
from queue import SimpleQueue

from neurosym_jax.__main__ import main

__all__ = ["serve"]


def serve() -> None:
    """Train until there is nothing more to read, which ends the process."""
    answers = os.fdopen(os.dup(sys.stdout.fileno()), "w")
    lines: SimpleQueue[str] = SimpleQueue()
    threading.Thread(target=_read, args=(lines,), daemon=True).start()
    while True:
        log, *arguments = json.loads(lines.get())
        answers.write(f"{_train(log, arguments)}\n")
        answers.flush()


def _read(lines: SimpleQueue[str]) -> None:
    for line in sys.stdin:
        lines.put(line)
    os._exit(0)  # There is nobody left to answer.


def _train(log: str, arguments: list[str]) -> int:
    with open(log, "a") as file:
        # What XLA says comes from C++, which knows the numbers of the streams alone.
        for stream in (sys.stdout, sys.stderr):
            os.dup2(file.fileno(), stream.fileno())
    try:
        main(["train", *arguments])
    except SystemExit as end:
        return end.code if isinstance(end.code, int) else 1
    except Exception:
        traceback.print_exc()
        return 1
    finally:
        sys.stdout.flush()
        sys.stderr.flush()
    return 0


if __name__ == "__main__":
    serve()
