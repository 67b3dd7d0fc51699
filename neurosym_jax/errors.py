"""Errors and warnings about a user's input; commands print each as a single line."""

import contextlib
import importlib
import os
import reprlib
import shlex
import sys
import traceback
import warnings
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

__all__ = [
    "InputError",
    "InputWarning",
    "NoWindowsError",
    "TrainingError",
    "brief",
    "line_of",
    "option",
    "optional_module",
]
__all__ += ["printable", "refuse_masked", "spoken_as_flags", "warn_caller"]

_spoken = {"flags": False}  # of the process: threads read for a command, too


class InputError(ValueError):
    """Input that cannot be used; the message names the file, the row and the reason."""


class InputWarning(UserWarning):
    """Input that can be used but looks wrong; the message names the file."""


def warn_caller(text: str) -> None:
    """Warn of the line outside this package that led here, however many calls lie between."""
    package = f"{Path(__file__).parent}{os.sep}"
    level = 1
    frame: Any = sys._getframe()
    while frame.f_back is not None and frame.f_code.co_filename.startswith(package):
        frame = frame.f_back
        level += 1
    warnings.warn(text, InputWarning, level)


class NoWindowsError(InputError):
    """Recordings that can be read, but are too short, or have too few people, for a window."""


class TrainingError(InputError):
    """Training cannot continue or be resumed; saved states are kept."""


@contextlib.contextmanager
def spoken_as_flags() -> Iterator[None]:
    """Let `option` name flags of a command in this context, in place of arguments of Python."""
    before = _spoken["flags"]
    _spoken["flags"] = True
    try:
        yield
    finally:
        _spoken["flags"] = before


def option(name: str, value: object = "") -> str:
    """An option as the caller writes it, for a message: `fps=25`, or `--fps 25` in a command.

    Values of a tuple are texts; without a value only the name is said.
    """
    values = value if isinstance(value, tuple) else (value,)
    if value == "":
        values = ()
    if not _spoken["flags"]:
        return f"{name}={value!r}" if values else name
    words = [shlex.quote(str(part)) for part in values if part is not True]
    return " ".join([f"--{name.replace('_', '-')}", *words])


def line_of(error: BaseException) -> str:
    """The innermost line outside installed libraries that an error passed: FILE:LINE: `CODE`."""
    frames = traceback.extract_tb(error.__traceback__)
    own = [frame for frame in frames if "site-packages" not in frame.filename]
    last = own[-1]
    return f"{last.filename}:{last.lineno}: `{last.line}`"


def optional_module(name: str, what: str, extra: str) -> Any:
    """Import the module `name` of a library that the package's `extra` brings.

    Raises:
        InputError: saying `what` needs it and how it is installed, where it is not.
    """
    try:
        return importlib.import_module(name)
    except ImportError:
        install = f"pip install 'neurosym-jax[{extra}]'"
        raise InputError(f"{what} needs {name}: {install}") from None


def printable(text: str) -> str:
    """Foreign text with characters escaped that would steer a terminal or cannot be written."""
    return "".join(
        letter if letter.isprintable() else letter.encode("unicode_escape").decode()
        for letter in text
    )


class _Brief(reprlib.Repr):
    """A `repr` that takes little time whatever the value: foreign lists may share parts."""

    def __init__(self):
        super().__init__()
        self.maxlevel, self.maxstring, self.maxother = 3, 80, 120

    def repr_int(self, x: int, level: int) -> str:
        if x.bit_length() > 128:
            return f"an integer of {x.bit_length()} bits"
        return repr(x)

    def repr_instance(self, x: object, level: int) -> str:
        if isinstance(x, dict):
            return self.repr_dict(x, level)
        return super().repr_instance(x, level)


brief = _Brief().repr
"""The `repr` of a foreign value, of its first 80 to 120 letters, for a message."""


def refuse_masked(arrays: Mapping[str, Any]) -> None:
    """Refuse arrays by name with masked values, which NumPy would read as what is behind the mask.

    Raises:
        InputError: naming the first.
    """
    import numpy as np

    for name, values in arrays.items():
        parts = values if isinstance(values, list | tuple) else (values,)
        if any(map(np.ma.is_masked, parts)):
            raise InputError(f"{name}: some values are masked; leave out these agents")
