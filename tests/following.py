"""Which files of the package run for what a user does: those that a reader has to follow."""

import contextlib
import sys
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import neurosym_jax

FOLDER = str(Path(neurosym_jax.__file__).parent)
HOOKS = {"runtime/compiled.py"}
"""What JAX's cache calls, in a process in which an earlier test has switched it on."""


@contextlib.contextmanager
def followed() -> Iterator[set[str]]:
    """Fill a set with the files whose code runs in the context; what imports run is not counted."""
    files: set[str] = set()
    passed: set[str] = set()

    def called(frame: Any, event: str, _: Any) -> None:
        file = frame.f_code.co_filename
        if file in passed or not file.startswith(FOLDER):
            return
        while frame is not None and frame.f_code.co_name != "<module>":
            frame = frame.f_back
        if frame is None or not frame.f_code.co_filename.startswith(FOLDER):
            passed.add(file)
            name = file[len(FOLDER) + 1 :]
            files.update({name} - HOOKS)

    # A tracer is called at calls alone, as it returns nothing; a profiler at returns,
    # too.
    threading.settrace(called)
    sys.settrace(called)
    try:
        yield files
    finally:
        sys.settrace(None)
        threading.settrace(None)
