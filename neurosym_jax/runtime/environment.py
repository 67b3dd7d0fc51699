"""The environment that a run's bits depend on: versions, threads, instruction set."""

import importlib.metadata
import os
import platform
import subprocess
from pathlib import Path
from typing import Any

import jax

__all__ = ["code_version", "cpu_cores", "cpu_threads", "run_environment"]

_PACKAGES = ("jax", "jaxlib", "flax", "optax", "numpy", "orbax-checkpoint")


def run_environment() -> dict[str, Any]:
    """Versions, threads, instruction set, device and precision; JSON-able. Starts JAX's backend."""
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


def code_version() -> str | None:
    """The commit of this checkout, with `-dirty` if it has changes; None outside a checkout."""
    root = Path(__file__).resolve().parents[2]
    if not (root / ".git").exists():
        return None
    command = ["git", "-C", str(root), "describe", "--always", "--dirty", "--abbrev=40"]
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=30, check=True)
    except (OSError, subprocess.SubprocessError):
        return None
    return done.stdout.strip() or None


def cpu_threads() -> int:
    """The size of XLA's thread pool on a CPU, by its own rule."""
    for name in ("PJRT_NPROC", "NPROC"):
        if os.environ.get(name, "").isdecimal():
            return int(os.environ[name])
    return cpu_cores()


def cpu_cores() -> int:
    """Cores that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def _instruction_set() -> str:
    """The architecture and, on Linux, its widest vector extension."""
    machine = platform.machine()
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        return machine
    flags = {f for line in lines if line.startswith(("flags", "Features")) for f in line.split()}
    widest = ("avx512f", "avx2", "avx", "sse4_2", "sve2", "sve", "asimd")
    return next((f"{machine} {name}" for name in widest if name in flags), machine)
