"""What a result's bits depend on: versions, threads, device; its provenance; the free memory."""

import hashlib
import importlib.metadata
import os
import platform
import shlex
import subprocess
import sys
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import jax

from neurosym_jax.errors import InputError

__all__ = ["available_memory", "code_version", "cpu_cores", "provenance", "refuse_beyond_memory"]
__all__ += ["run_environment"]

_PACKAGES = ("jax", "jaxlib", "flax", "optax", "numpy", "orbax-checkpoint")
_VECTORS = ("avx512f", "avx2", "avx", "sse4_2", "sve2", "sve", "asimd")


def run_environment() -> dict[str, Any]:
    """Versions, threads, instruction set, device and precision; JSON-able. Starts JAX's backend."""
    device, info = jax.devices()[0], Path("/proc/cpuinfo")
    known = info.read_text().split() if info.exists() else []
    vectors = [name for name in _VECTORS if name in known][:1]  # the widest
    return {
        "python": platform.python_version(),
        **{name: importlib.metadata.version(name) for name in _PACKAGES},
        # By XLA's own rule.
        "threads": int(os.environ.get("PJRT_NPROC") or os.environ.get("NPROC") or cpu_cores()),
        "cpu": " ".join([platform.machine(), *vectors]),
        "platform": device.platform,
        "device": device.device_kind,
        "x64": bool(jax.config.read("jax_enable_x64")),
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
        "version": importlib.metadata.version("neurosym-jax"),
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
    return len(os.sched_getaffinity(0)) if sys.platform == "linux" else os.cpu_count() or 1


def _digests(paths: Iterable[Path | str]) -> dict[str, str]:
    """SHA-256 in hexadecimal, as `sha256sum` prints it, of each file that is there."""
    found = {}
    for path in dict.fromkeys(map(Path, paths)):
        for file in sorted(path.iterdir()) if path.is_dir() else [path]:
            if file.is_file():
                with file.open("rb") as content:
                    found[str(file)] = hashlib.file_digest(content, "sha256").hexdigest()
    return found


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
