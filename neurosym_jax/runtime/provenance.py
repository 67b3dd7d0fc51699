"""The provenance of a result: code, command, files and machine."""

import hashlib
import importlib.metadata
import shlex
import sys
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from neurosym_jax.runtime.environment import code_version, run_environment

__all__ = ["provenance"]


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


def _digests(paths: Iterable[Path | str]) -> dict[str, str]:
    """SHA-256 in hexadecimal, as `sha256sum` prints it, of each file that is there."""
    found = {}
    for path in dict.fromkeys(map(Path, paths)):
        for file in sorted(path.iterdir()) if path.is_dir() else [path]:
            if file.is_file():
                with file.open("rb") as content:
                    found[str(file)] = hashlib.file_digest(content, "sha256").hexdigest()
    return found
