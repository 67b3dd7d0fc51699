"""Refuse an allocation that cannot fit before it is tried, and name the option to lower."""

import os
from pathlib import Path

from neurosym_jax.errors import InputError

__all__ = ["available_memory", "refuse_beyond_memory"]


def available_memory() -> float:
    """Bytes available without swapping; the machine's total where only that is known."""
    try:
        lines = Path("/proc/meminfo").read_text().splitlines()
        fields = dict(line.split(":") for line in lines)
        return 1024.0 * int(fields["MemAvailable"].split()[0])
    except (OSError, KeyError, ValueError):
        pass
    try:
        return float(os.sysconf("SC_PAGE_SIZE")) * os.sysconf("SC_PHYS_PAGES")
    except (AttributeError, OSError, ValueError):
        return float("inf")


def refuse_beyond_memory(what: str, needed: float, remedy: str) -> None:
    """Refuse work that needs more memory than is available.

    Args:
        what: the work, for people.
        needed: bytes.
        remedy: the option to lower, for people.

    Raises:
        InputError: naming both sizes and the remedy.
    """
    there = available_memory()
    if needed > there:
        raise InputError(
            f"{what} needs some {needed / 1e9:.1f} GB of memory, and {there / 1e9:.1f} GB are "
            f"free: {remedy}"
        )
