"""Refuse an allocation that cannot fit before it is tried, and name the option to lower."""

from pathlib import Path

from neurosym_jax.errors import InputError

__all__ = ["available_memory", "refuse_beyond_memory"]


def available_memory() -> float:
    """Bytes available without swapping; infinite where that is not known."""
    info = Path("/proc/meminfo")
    if not info.exists():
        return float("inf")
    fields = dict(line.split(":") for line in info.read_text().splitlines())
    return 1024.0 * int(fields["MemAvailable"].split()[0])


def refuse_beyond_memory(what: str, needed: float, remedy: str) -> None:
    """Refuse work that needs more bytes than are available.

    Raises:
        InputError: naming the work, both sizes and the remedy.
    """
    there = available_memory()
    if needed > there:
        raise InputError(
            f"{what} needs some {needed / 1e9:.1f} GB of memory, and {there / 1e9:.1f} GB are "
            f"free: {remedy}"
        )
