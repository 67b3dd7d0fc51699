"""This process: its settings, its progress, and what its results depend on.

Scripts and commands switch settings (compilation cache, memory allocator, XLA flags)
on, never `import neurosym_jax`. JAX is imported by functions that need it alone: a
command on an .onnx model runs without.
"""

import contextlib
import ctypes
import hashlib
import importlib.metadata
import itertools
import math
import os
import platform
import shlex
import subprocess
import sys
import time
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

from neurosym_jax.errors import InputError, printable
from neurosym_jax.plugins import installed_version

__all__ = [
    "COMPILED_QUICKLY",
    "COMPILED_UNFUSED",
    "available_memory",
    "cache_folder",
    "code_version",
    "cpu_cores",
    "enable_compilation_cache",
    "progress_of",
    "provenance",
    "refuse_beyond_memory",
    "refuse_forked",
    "run_environment",
    "tune",
]


def _version_of(package: str) -> str:
    """The installed version, empty where there is none."""
    try:
        return importlib.metadata.version(package)
    except importlib.metadata.PackageNotFoundError:
        return ""


_LEVEL = "xla_backend_optimization_level"
_EMITTERS = "xla_cpu_use_fusion_emitters"
_KNOWN_VERSION = _version_of("jax").startswith("0.10.")
"""Whether this version of JAX was tried with flags of XLA, of which an unknown one ends a process."""


def _unless_set(options: dict[str, Any]) -> dict[str, Any]:
    """Those of `options` that `XLA_FLAGS` does not name."""
    flags = os.environ.get("XLA_FLAGS", "")
    return {name: value for name, value in options.items() if name not in flags}


COMPILED_QUICKLY = _unless_set({_LEVEL: 1})
"""`compiler_options` of programs that take longer to compile than to run: sooner, with the same
bits."""

COMPILED_UNFUSED = _unless_set(
    {_LEVEL: 1} | ({_EMITTERS: False} if _KNOWN_VERSION else {})
)
"""`compiler_options` of programs without loops: half the time to compile and the same to run. The
last digits differ, and a loop over an LSTM's steps would run at half the speed."""

_VECTORS = "--xla_cpu_prefer_vector_width"
_TRIM_THRESHOLD, _MMAP_MAX, _ARENA_MAX = -1, -4, -8
"""Parameters of mallopt in glibc's malloc.h."""
_forked: list[int] = []
"""This process, if it was forked once JAX ran in its parent, whose threads it lacks."""
_PACKAGES = ("jax", "jaxlib", "flax", "optax", "numpy", "orbax-checkpoint")
_INSTRUCTIONS = ("avx512f", "avx2", "avx", "sse4_2", "sve2", "sve", "asimd")


def cache_folder() -> Path | None:
    """The user's cache folder of this project (`$XDG_CACHE_HOME`, else `~/.cache`).

    None if it cannot be made; in a container the user may have neither a name nor a
    home.
    """
    try:
        folder = (
            Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
            / "neurosym_jax"
        )
        folder.mkdir(parents=True, exist_ok=True)
    except (OSError, RuntimeError):
        return None
    return folder


def enable_compilation_cache() -> None:
    """Keep compiled programs between processes, unless `NEUROSYM_NO_CACHE` is set.

    A damaged or stale program is compiled again. The folder must be the user's own:
    whoever can write there can run code. What others own is not used.
    """
    if os.environ.get("NEUROSYM_NO_CACHE") or (folder := cache_folder()) is None:
        return
    from neurosym_jax.runtime.compiled import keep_programs, private_folder
    from neurosym_jax.runtime.programs import keep_whole

    # JAX's key does not know the number of threads, which changes what is compiled.
    programs_of_jax = folder / f"xla-threads-{os.environ.get('NPROC', 'all')}"
    if private_folder(programs_of_jax):
        keep_programs(programs_of_jax)
    keep_whole(folder / "programs")


def tune() -> None:
    """Make compiled programs faster on a CPU, unless the environment sets the same options.

    Call it before JAX's backend starts. It keeps freed buffers in the process (unless
    `MALLOC_*` or `GLIBC_TUNABLES` is set): otherwise each call touches every page for
    the first time, a quarter of a training iteration. It lets XLA use 512-bit vectors
    (unless `XLA_FLAGS` sets their width), in versions of JAX where this was tried;
    XLA's default is 256 bits.
    """
    if not any(name.startswith(("MALLOC_", "GLIBC_TUNABLES")) for name in os.environ):
        # C libraries other than glibc have no mallopt.
        with contextlib.suppress(AttributeError, OSError, TypeError):
            mallopt = ctypes.CDLL(None).mallopt
            # One arena, because other threads' arenas map blocks larger than 64 MB; no
            # mapping, no trimming.
            for parameter, value in (
                (_ARENA_MAX, 1),
                (_MMAP_MAX, 0),
                (_TRIM_THRESHOLD, -1),
            ):
                mallopt(parameter, value)
    flags = os.environ.get("XLA_FLAGS", "")
    # An unknown flag ends the process, so it is set only in versions that are known to
    # have it.
    if _VECTORS not in flags and _KNOWN_VERSION:
        os.environ["XLA_FLAGS"] = f"{flags} {_VECTORS}=512".strip()


def progress_of(total: int) -> Callable[[str], None]:
    """A function to call after each of `total` steps; it prints a line on the standard error."""
    since = time.perf_counter()
    count = itertools.count(1)

    def step(task: str) -> None:
        seconds = time.perf_counter() - since
        line = f"[{next(count)}/{total}] {task} ({seconds:.1f} s)"
        print(printable(line), file=sys.stderr)

    return step


def run_environment() -> dict[str, Any]:
    """Versions, threads, instruction set, device and precision; JSON-able. Starts JAX's backend."""
    import jax

    device = jax.devices()[0]
    info = Path("/proc/cpuinfo")
    words = info.read_text().split() if info.exists() else []
    vectors = [name for name in _INSTRUCTIONS if name in words][:1]  # the widest
    return {
        "python": platform.python_version(),
        **{name: importlib.metadata.version(name) for name in _PACKAGES},
        # By XLA's own rule.
        "threads": int(
            os.environ.get("PJRT_NPROC") or os.environ.get("NPROC") or cpu_cores()
        ),
        "cpu": " ".join([platform.machine(), *vectors]),
        "platform": device.platform,
        "device": device.device_kind,
        "x64": bool(jax.config.read("jax_enable_x64")),
        # See `runtime.programs`.
        "products": jax.default_matmul_precision.value or "highest",
        "xla_flags": os.environ.get("XLA_FLAGS", ""),
    }


def provenance(
    data: Iterable[Path | str] = (), models: Iterable[Path | str] = ()
) -> dict[str, Any]:
    """Version, commit, command line, SHA-256 of files by path, and the environment; JSON-able.

    Args:
        data: files that were read.
        models: files, or folders, whose files are listed.
    """
    return {
        "version": installed_version(),
        "commit": code_version(),
        "command": shlex.join([Path(sys.argv[0]).name, *sys.argv[1:]]),
        "data": _digests(data),
        "checkpoints": _digests(models),
        "environment": run_environment(),
    }


def code_version() -> str | None:
    """The commit of this checkout, with `-dirty` if it has changes; None outside a checkout."""
    root = Path(__file__).resolve().parents[2]
    if not (root / ".git").exists():
        return None
    command = ["git", "-C", str(root), "describe", "--always", "--dirty", "--abbrev=40"]
    try:
        return subprocess.check_output(command, text=True, timeout=30).strip() or None
    except (OSError, subprocess.SubprocessError):
        return None


def cpu_cores() -> int:
    """Cores that this process may use."""
    if sys.platform == "linux":
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def _digests(paths: Iterable[Path | str]) -> dict[str, str]:
    """SHA-256 in hexadecimal, as `sha256sum` prints it, of each file that is there."""
    digests = {}
    for path in dict.fromkeys(map(Path, paths)):
        for file in sorted(path.iterdir()) if path.is_dir() else [path]:
            if file.is_file():
                with file.open("rb") as content:
                    digests[str(file)] = hashlib.file_digest(
                        content, "sha256"
                    ).hexdigest()
    return digests


def _note_fork() -> None:
    bridge = sys.modules.get("jax._src.xla_bridge")
    if bridge is not None and bridge.backends_are_initialized():
        _forked[:] = [os.getpid()]


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_note_fork)


def refuse_forked() -> None:
    """Refuse to compute in a child that was forked once JAX ran in its parent: it would not end.

    Raises:
        InputError: with how to start such a process.
    """
    if _forked:
        raise InputError(
            "forked after its parent had used JAX, this process would wait for ever: start it with "
            "multiprocessing's 'spawn' or 'forkserver'"
        )


# Memory that is free for this process: of the machine, of its container, and by its own
# limit.

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
    numbers = {}
    for line in _lines(path):
        name, number, *_ = [*line.split(), "", ""]
        if number.isdigit():
            numbers[name] = int(number)
    return numbers


def _number(path: Path) -> int | None:
    """The number in a file of the kernel; None for `max`, and where it cannot be read."""
    words = _lines(path)
    return int(words[0]) if words and words[0].isdigit() else None
