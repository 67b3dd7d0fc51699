"""Several processes as one, by JAX's own distributed runtime: joining, and adding up what each did.

Every process runs the same command on the same data and does a share of the work; the first one
prints and writes. On one machine alone nothing here does anything.
"""

import dataclasses
import os
import sys
import time
from collections.abc import Sequence
from typing import Any, TypeVar

import jax
import numpy as np

from neurosym_jax.errors import InputError

__all__ = [
    "ALONE",
    "Processes",
    "is_first",
    "join",
    "leave",
    "share",
    "sum_over_processes",
]

Item = TypeVar("Item")


@dataclasses.dataclass(frozen=True)
class Processes:
    """Where the processes meet; a cluster that JAX knows (Slurm, Kubernetes) needs `auto` only."""

    coordinator: str | None = None
    """HOST:PORT of the first process; each of several processes is started with it."""
    count: int | None = None
    """How many processes there are."""
    index: int | None = None
    """Which of them this one is, from 0."""
    auto: bool = False
    """Take all three from the cluster that the process was started by."""


ALONE = Processes()
"""One process."""


def join(processes: Processes) -> None:
    """Wait for the others, where there are any; before anything else is done with jax.

    Raises:
        InputError: for options that do not go together, or others that do not come.
    """
    if processes == ALONE:
        return
    given = [processes.coordinator, processes.count, processes.index]
    if None in given and not (processes.auto and given == [None] * 3):
        raise InputError("coordinator, count and index of processes go together, or auto alone")
    # Else a SIGTERM is only noted, for a preemption that nobody here waits for.
    jax.config.update("jax_enable_preemption_service", False)
    try:
        jax.distributed.initialize(processes.coordinator, processes.count, processes.index)
    except (RuntimeError, ValueError) as error:
        reason = str(error).strip().splitlines()[0]
        raise InputError(f"the processes did not come together: {reason}") from None


def is_first() -> bool:
    """Whether this process is the one that prints and writes."""
    return jax.process_index() == 0


def share(items: Sequence[Item]) -> list[tuple[int, Item]]:
    """(number, item) of those that this process works on; every item is exactly one's."""
    return list(enumerate(items))[jax.process_index() :: jax.process_count()]


def leave(status: int, words: str = "") -> None:
    """End this process where it is one of several, with last `words`, and so the others' waiting.

    By itself a joined process waits for the others before it ends, and they for it.
    """
    if jax.distributed.is_initialized() and jax.process_count() > 1:
        print(words, end="", file=sys.stderr)
        sys.stdout.flush()
        sys.stderr.flush()
        if is_first():
            # The others are aborted when it ends: time for their own words, if they have any.
            time.sleep(2)
        os._exit(status)


def sum_over_processes(array: np.ndarray) -> np.ndarray:
    """The sum of every process's float64 `array` [...], of one shape in all; waits for all.

    Numbers travel as their bits, because JAX's arrays would be rounded to float32. Where all but
    one are zero the sum is that one's, exactly.
    """
    if jax.process_count() == 1:
        return array
    from jax.experimental.multihost_utils import process_allgather

    bits = np.ascontiguousarray(array, np.float64).view(np.uint32)
    gathered: Any = np.asarray(process_allgather(bits))
    return np.ascontiguousarray(gathered).view(np.float64).sum(axis=0)
