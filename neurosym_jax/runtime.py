"""Process-wide settings of jax, made by scripts and commands, never by `import neurosym_jax`."""

import importlib.metadata
import os
import platform
from pathlib import Path
from typing import Any

import jax

__all__ = [
    "cache_folder",
    "compile_seconds",
    "cpu_threads",
    "enable_compilation_cache",
    "run_environment",
]

_COMPILE_EVENTS = (
    "/jax/core/compile/jaxpr_trace_duration",
    "/jax/core/compile/jaxpr_to_mlir_module_duration",
    "/jax/core/compile/backend_compile_duration",
)

_compiled = 0.0


def _count(event: str, duration_secs: float, **kwargs: str | int) -> None:
    global _compiled
    if event in _COMPILE_EVENTS:
        _compiled += duration_secs


jax.monitoring.register_event_duration_secs_listener(_count)


def compile_seconds() -> float:
    """Seconds this process has spent tracing and compiling since this module was imported."""
    return _compiled


def cache_folder() -> Path:
    """The user's own cache folder of this project (`$XDG_CACHE_HOME`, else `~/.cache`)."""
    base = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return Path(base) / "neurosym_jax"


def enable_compilation_cache() -> None:
    """Keep compiled programs between processes, unless `NEUROSYM_NO_CACHE` is set.

    Cached programs are executed as they are found, so the folder must be the user's own.
    """
    if os.environ.get("NEUROSYM_NO_CACHE"):
        return
    jax.config.update("jax_compilation_cache_dir", str(cache_folder() / "xla"))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
    jax.config.update("jax_persistent_cache_min_entry_size_bytes", 0)


_PACKAGES = ("jax", "jaxlib", "flax", "optax", "numpy", "orbax-checkpoint")


def run_environment() -> dict[str, Any]:
    """What a run's bits depend on besides its configuration and data; JSON-able.

    Starts jax's backend, so set `NPROC` or `XLA_FLAGS` before.
    """
    device = jax.devices()[0]
    return {
        "python": platform.python_version(),
        **{name: importlib.metadata.version(name) for name in _PACKAGES},
        "threads": cpu_threads(),
        "cpu": _instruction_set(),
        "platform": device.platform,
        "device": device.device_kind,
        "x64": bool(jax.config.read("jax_enable_x64")),
        "xla_flags": os.environ.get("XLA_FLAGS", ""),
    }


def cpu_threads() -> int:
    """The size of XLA's thread pool on a CPU, by its own rule."""
    for name in ("PJRT_NPROC", "NPROC"):
        if os.environ.get(name, "").isdecimal():
            return int(os.environ[name])
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def _instruction_set() -> str:
    """The architecture and, where Linux tells, its widest vector extension."""
    machine = platform.machine()
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        return machine
    flags = {f for line in lines if line.startswith(("flags", "Features")) for f in line.split()}
    widest = ("avx512f", "avx2", "avx", "sse4_2", "sve2", "sve", "asimd")
    return next((f"{machine} {name}" for name in widest if name in flags), machine)
