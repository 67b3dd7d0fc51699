"""Seconds of several contestants, and the one form in which every benchmark gives its numbers."""

import statistics
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

OURS = "neurosym_jax"

Row = dict[str, Any]
"""case, who, unit, median, low, high, repeats; and whatever else is known of it."""


def peak_mb(process: int | str = "self") -> float:
    """The most memory that a running process has had so far, or this one's accelerator, MB.

    What `getrusage` says of a process counts its parent's memory before the process was loaded.
    """
    if process == "self":
        import jax

        if statistics := jax.devices()[0].memory_stats():  # None on a CPU.
            return statistics["peak_bytes_in_use"] / 1e6
    status = Path(f"/proc/{process}/status").read_text()
    return next(int(line.split()[1]) for line in status.splitlines() if "VmHWM" in line) / 1024


def alternate(
    contestants: Mapping[str, Callable[[], object]], rounds: int, warm: int = 1
) -> dict[str, list[float]]:
    """Seconds of each round of each contestant, after `warm` rounds that do not count.

    Rounds alternate, so that what else the machine does falls on all of them.
    """
    seconds: dict[str, list[float]] = {name: [] for name in contestants}
    for number in range(warm + rounds):
        for name, run in contestants.items():
            start = time.perf_counter()
            run()
            if number >= warm:
                seconds[name].append(time.perf_counter() - start)
    return seconds


def row(case: str, who: str, values: Sequence[float], unit: str = "s", **columns: Any) -> Row:
    """Median and spread of one contestant."""
    return {
        "case": case,
        "who": who,
        "unit": unit,
        "median": statistics.median(values),
        "low": min(values),
        "high": max(values),
        "repeats": len(values),
        **columns,
    }


def rows(case: str, seconds: Mapping[str, Sequence[float]]) -> list[Row]:
    """A row each, with `ratio`: how many times our median theirs is."""
    table = [row(case, who, values) for who, values in seconds.items()]
    median_of_ours = next(entry["median"] for entry in table if entry["who"] == OURS)
    return [{**entry, "ratio": entry["median"] / median_of_ours} for entry in table]


def text(result: Mapping[str, Any]) -> str:
    """A benchmark's result for people."""
    lines = [result["title"]]
    for entry in result["rows"]:
        scale, unit = (1000, "ms") if entry["unit"] == "s" and entry["median"] < 0.5 else (1, "")
        unit = unit or entry["unit"]
        low, middle, high = (f"{entry[part] * scale:.4g}" for part in ("low", "median", "high"))
        details = f"  {entry['ratio']:.1f} times ours" if entry.get("ratio", 1) != 1 else ""
        if "p99" in entry:
            details += f"  p99 {entry['p99'] * scale:.4g} {unit}"
        extras = ("peak_mb", "ade", "answered", "drawn")
        details += "".join(f"  {name} {entry[name]:.4g}" for name in extras if name in entry)
        lines.append(
            f"  {entry['case']:32} {entry['who']:14} {middle:>9} {unit} ({low} to {high}){details}"
        )
    if light := result.get("light"):
        lines.append(
            f"  speed of light {light['seconds']:.4g} s: {light['flops'] / 1e9:.3g} GFLOP and "
            f"{light['transcendentals'] / 1e9:.3g} G of tanh and sigmoid; reached "
            f"{100 * light['fraction']:.0f} %"
        )
    for name, seconds in result.get("stages", {}).items():
        lines.append(f"    {name:30} {seconds:.3g} s")
    return "\n".join(lines)
