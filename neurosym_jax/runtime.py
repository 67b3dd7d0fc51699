"""Compiling in this process: the cache of programs, and the seconds that it took.

The cache is switched on by scripts and commands, never by `import neurosym_jax`. What there is to
compile for is `environment`'s.
"""

import os
from pathlib import Path

import jax

__all__ = ["cache_folder", "compile_seconds", "enable_compilation_cache"]

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
