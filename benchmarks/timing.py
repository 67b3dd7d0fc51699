"""Seconds of several contestants, and the one form in which every benchmark gives its numbers."""

import contextlib
import math
import multiprocessing
import statistics
import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any, NamedTuple

from neurosym_jax.runtime.process import enable_compilation_cache, tune

OURS = "neurosym_jax"
ROUND = 0.5  # seconds that a round lasts at least
REST = 0.1  # seconds between rounds of different contestants

Row = dict[str, Any]
"""case, who, unit, median, low, high, repeats; and whatever else is known of it."""


def peak_mb(process: int | str = "self") -> float:
    """The most memory that a running process has had so far, or this one's accelerator, MB.

    What `getrusage` says of a process counts its parent's memory before the process was
    loaded.
    """
    if process == "self":
        import jax

        statistics = jax.devices()[0].memory_stats()
        if statistics:  # None on a CPU.
            return statistics["peak_bytes_in_use"] / 1e6
    status = Path(f"/proc/{process}/status").read_text()
    return (
        next(int(line.split()[1]) for line in status.splitlines() if "VmHWM" in line)
        / 1024
    )


class Timing(NamedTuple):
    """The rounds of one contestant that count."""

    seconds: list[float]
    cpu_seconds: list[float]
    """Of all its threads."""
    peak_mb: float
    result: Any
    """What the last round returned."""


def alternate(
    contestants: Mapping[str, Callable[[], Callable[[], Any]]],
    rounds: int,
    warm: int = 1,
) -> dict[str, Timing]:
    """Time contestants in a process each, after `warm` rounds that do not count.

    A contestant makes, in its process, the function that is timed. Rounds alternate, so
    that what else the machine does falls on all of them, with a rest between them,
    because a library's threads spin for a while after their work.
    """
    context = multiprocessing.get_context("spawn")
    timed: dict[str, list[Timing]] = {name: [] for name in contestants}
    with contextlib.ExitStack() as stack:
        processes = {
            name: stack.enter_context(
                ProcessPoolExecutor(1, context, _prepare, (make,))
            )
            for name, make in contestants.items()
        }
        for _ in range(warm + rounds):
            for name, process in processes.items():
                time.sleep(REST if len(contestants) > 1 else 0)
                timed[name].append(process.submit(_round).result())
    merged = {}
    for name, timings in timed.items():
        seconds = [timing.seconds[0] for timing in timings[warm:]]
        cpu_seconds = [timing.cpu_seconds[0] for timing in timings[warm:]]
        merged[name] = Timing(seconds, cpu_seconds, *timings[-1][2:])
    return merged


def apart(function: Callable[..., Any], *arguments: Any) -> Any:
    """What a function returns in a process of its own."""
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(1, context, _prepare) as process:
        return process.submit(function, *arguments).result()


def _prepare(make: Callable[[], Any] = lambda: None) -> None:
    tune()
    enable_compilation_cache()
    globals()["_contestant"] = make()


def _round() -> Timing:
    """Short runs repeat; the first is not counted, because others have had the caches."""
    timing = _mean_of(1)
    (seconds,) = timing.seconds
    return timing if seconds > ROUND else _mean_of(math.ceil(ROUND / seconds))


def _mean_of(runs: int) -> Timing:
    seconds, cpu_seconds, result = time.perf_counter(), time.process_time(), None
    for _ in range(runs):
        result = globals()["_contestant"]()
    seconds, cpu_seconds = (
        time.perf_counter() - seconds,
        time.process_time() - cpu_seconds,
    )
    return Timing([seconds / runs], [cpu_seconds / runs], peak_mb(), result)


def row(
    case: str, who: str, values: Sequence[float], unit: str = "s", **columns: Any
) -> Row:
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


def rows(case: str, timings: Mapping[str, Timing]) -> list[Row]:
    """A row each, with `cpu`, and `ratio`: how many times our median theirs is."""
    table = [
        row(
            *(case, who, timing.seconds),
            cpu=statistics.median(timing.cpu_seconds),
            peak_mb=timing.peak_mb,
        )
        for who, timing in timings.items()
    ]
    median_of_ours = next(entry["median"] for entry in table if entry["who"] == OURS)
    return [{**entry, "ratio": entry["median"] / median_of_ours} for entry in table]


def text(result: Mapping[str, Any]) -> str:
    """A benchmark's result for people."""
    lines = [result["title"]]
    for entry in result["rows"]:
        scale, unit = (
            (1000, "ms") if entry["unit"] == "s" and entry["median"] < 0.5 else (1, "")
        )
        unit = unit or entry["unit"]
        low, middle, high = (
            f"{entry[part] * scale:.4g}" for part in ("low", "median", "high")
        )
        details = (
            f"  {entry['ratio']:.1f} times ours" if entry.get("ratio", 1) != 1 else ""
        )
        if "cpu" in entry:
            details += f"  CPU {entry['cpu'] * scale:.4g} {unit}"
        if "p99" in entry:
            details += f"  p99 {entry['p99'] * scale:.4g} {unit}"
        extras = ("peak_mb", "ade", "answered", "drawn")
        details += "".join(
            f"  {name} {entry[name]:.4g}" for name in extras if name in entry
        )
        lines.append(
            f"  {entry['case']:32} {entry['who']:14} {middle:>9} {unit} ({low} to {high}){details}"
        )
    light = result.get("light")
    if light:
        lines.append(
            f"  speed of light {light['seconds']:.4g} s: {light['flops'] / 1e9:.3g} GFLOP and "
            f"{light['transcendentals'] / 1e9:.3g} G of tanh and sigmoid; reached "
            f"{100 * light['fraction']:.0f} %"
        )
    for name, seconds in result.get("stages", {}).items():
        lines.append(f"    {name:30} {seconds:.3g} s")
    return "\n".join(lines)
