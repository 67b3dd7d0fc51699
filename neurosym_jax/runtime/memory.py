"""Memory that is free for this process: of the machine, of its container, and by its own limit."""

import math
import os
from pathlib import Path

from neurosym_jax.errors import InputError

__all__ = ["available_memory", "refuse_beyond_memory"]

SURE = 50e6
"""Bytes that are free wherever JAX runs."""
UNLIMITED = 2**60
"""Control groups without a limit say `max`, or a number of this size."""


def refuse_beyond_memory(work: str, needed: float, remedy: str) -> None:
    """Refuse work that needs more bytes than are available.

    Raises:
        InputError: naming the work, both sizes and the remedy.
    """
    # What is certainly there is not looked up: a robot asks before each forecast.
    if needed <= SURE:
        return
    free = available_memory()
    if needed > free:
        raise InputError(
            f"{work} needs some {needed / 1e9:.1f} GB of memory, and {free / 1e9:.1f} GB are "
            f"free: {remedy}"
        )


def available_memory() -> float:
    """Bytes available without swapping; infinite where that is not known.

    The least of what the machine has free (`/proc/meminfo`), what its control groups leave
    (a container's limit), and what the process may still take (`ulimit -v`).
    """
    return min(_of_machine(), _of_groups(), _of_process())


def _of_machine(info: Path = Path("/proc/meminfo")) -> float:
    fields = _numbers(info)
    return 1024.0 * fields.get("MemAvailable:", math.inf)


def _of_groups(
    own: Path = Path("/proc/self/cgroup"), root: Path = Path("/sys/fs/cgroup")
) -> float:
    """What the process's control group, and those around it, leave of their limits."""
    free = math.inf
    for line in _lines(own):
        _, kinds, place = line.split(":", 2)
        if not kinds:  # Version 2 has one tree for everything.
            group, names = root, ("memory.max", "memory.current")
        elif "memory" in kinds.split(","):
            group = root / "memory"
            names = ("memory.limit_in_bytes", "memory.usage_in_bytes")
        else:
            continue
        # Within a container the path may be that outside; its own group is the root.
        folders = [group]
        for part in place.strip("/").split("/"):
            folders.append(folders[-1] / part)
        for folder in folders:
            free = min(free, _left(folder, *names))
    return free


def _left(folder: Path, limit_name: str, used_name: str) -> float:
    """Bytes that a control group's limit leaves; infinite without a limit."""
    limit, used = (_number(folder / name) for name in (limit_name, used_name))
    if limit is None or used is None or limit >= UNLIMITED:
        return math.inf
    # Pages of files count as used, and are given back when they are wanted.
    cached = _numbers(folder / "memory.stat").get("inactive_file", 0)
    return max(0.0, limit - used + cached)


def _of_process(sizes: Path = Path("/proc/self/statm")) -> float:
    """What the limit of the process's address space (`ulimit -v`) leaves."""
    try:
        import resource
    except ImportError:  # Windows
        return math.inf
    limit, _ = resource.getrlimit(resource.RLIMIT_AS)
    lines = _lines(sizes)
    if limit == resource.RLIM_INFINITY or not lines:
        return math.inf
    used = int(lines[0].split()[0]) * os.sysconf("SC_PAGE_SIZE")
    return max(0.0, limit - used)


def _lines(path: Path) -> list[str]:
    """Lines of a file of the kernel; none where it cannot be read."""
    try:
        return path.read_text().splitlines()
    except OSError:
        return []


def _numbers(path: Path) -> dict[str, int]:
    """Name and number of each line of a file of the kernel."""
    rows = (line.split() for line in _lines(path))
    return {row[0]: int(row[1]) for row in rows if len(row) > 1 and row[1].isdigit()}


def _number(path: Path) -> int | None:
    """The number in a file of the kernel; None for `max`, and where it cannot be read."""
    words = _lines(path)
    return int(words[0]) if words and words[0].isdigit() else None
