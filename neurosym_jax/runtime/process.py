"""Settings of this process (compilation cache, memory allocator, XLA flags), and its progress.

Scripts and commands switch these on, never `import neurosym_jax`.
"""

import contextlib
import ctypes
import itertools
import os
import sys
import time
from collections.abc import Callable
from pathlib import Path

import jax

__all__ = ["COMPILED_QUICKLY", "cache_folder", "enable_compilation_cache", "progress_of", "tune"]

_LEVEL = "xla_backend_optimization_level"
COMPILED_QUICKLY = {} if _LEVEL in os.environ.get("XLA_FLAGS", "") else {_LEVEL: 1}
"""`compiler_options` of programs that take longer to compile than to run, such as random numbers:
compiled sooner, with the same bits. Empty where `XLA_FLAGS` sets the optimisation level."""

_VECTORS = "--xla_cpu_prefer_vector_width"
_TRIM_THRESHOLD, _MMAP_MAX, _ARENA_MAX = -1, -4, -8
"""Parameters of mallopt in glibc's malloc.h."""


def cache_folder() -> Path | None:
    """The user's cache folder of this project (`$XDG_CACHE_HOME`, else `~/.cache`).

    None if it cannot be made; in a container the user may have neither a name nor a home.
    """
    try:
        folder = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "neurosym_jax"
        folder.mkdir(parents=True, exist_ok=True)
    except (OSError, RuntimeError):
        return None
    return folder


def enable_compilation_cache() -> None:
    """Keep compiled programs between processes, unless `NEUROSYM_NO_CACHE` is set.

    JAX runs cached programs without a check, so the folder must be the user's own.
    """
    if os.environ.get("NEUROSYM_NO_CACHE") or (folder := cache_folder()) is None:
        return
    # The cache's key does not know the number of threads, which changes what is compiled.
    threads = os.environ.get("NPROC", "all")
    jax.config.update("jax_compilation_cache_dir", str(folder / f"xla-threads-{threads}"))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
    jax.config.update("jax_persistent_cache_min_entry_size_bytes", 0)


def tune() -> None:
    """Make compiled programs faster on a CPU, unless the environment sets the same options.

    Call it before JAX's backend starts. It keeps freed buffers in the process (unless `MALLOC_*` or
    `GLIBC_TUNABLES` is set): otherwise each call touches every page for the first time, a quarter
    of a training iteration. It lets XLA use 512-bit vectors (unless `XLA_FLAGS` sets their width),
    in versions of JAX where this was tried; XLA's default is 256 bits.
    """
    if not any(name.startswith(("MALLOC_", "GLIBC_TUNABLES")) for name in os.environ):
        # C libraries other than glibc have no mallopt.
        with contextlib.suppress(AttributeError, OSError, TypeError):
            mallopt = ctypes.CDLL(None).mallopt
            # One arena, because other threads' arenas map blocks larger than 64 MB; no mapping, no
            # trimming.
            for parameter, value in ((_ARENA_MAX, 1), (_MMAP_MAX, 0), (_TRIM_THRESHOLD, -1)):
                mallopt(parameter, value)
    flags = os.environ.get("XLA_FLAGS", "")
    # An unknown flag ends the process, so it is set only in versions that are known to have it.
    if _VECTORS not in flags and jax.__version_info__[:2] == (0, 10):
        os.environ["XLA_FLAGS"] = f"{flags} {_VECTORS}=512".strip()


def progress_of(total: int) -> Callable[[str], None]:
    """A function to call after each of `total` steps; it prints a line on the standard error."""
    since, count = time.perf_counter(), itertools.count(1)

    def step(what: str) -> None:
        seconds = time.perf_counter() - since
        print(f"[{next(count)}/{total}] {what} ({seconds:.1f} s)", file=sys.stderr)

    return step
