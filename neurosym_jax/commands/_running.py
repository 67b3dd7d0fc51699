"""From a command line to a call: options are a dataclass, bad input is one line, not a trace."""

import dataclasses
import errno
import signal
import sys
import warnings
from collections.abc import Callable, Sequence
from typing import Annotated, TypeVar

import tyro

from neurosym_jax.errors import InputError, InputWarning, printable
from neurosym_jax.plugins import load_entry_points, load_plugin
from neurosym_jax.runtime.process import enable_compilation_cache, tune

__all__ = ["run_command", "with_plugins"]

Options = TypeVar("Options")

OF_THE_DISK = (errno.ENOSPC, errno.EDQUOT, errno.EROFS, errno.EACCES, errno.EIO)
"""Errors that say nothing of our code."""

PLUGIN = (
    "File or module of one's own that is imported first, for the metrics, forecasters, poolings, "
    "weightings and formats it registers; may be repeated."
)
Plugins = Annotated[
    tyro.conf.UseAppendAction[tuple[str, ...]],
    tyro.conf.arg(metavar="FILE.py|MODULE", help=PLUGIN, help_behavior_hint=""),
]


def run_command(
    options: type[Options],
    action: Callable[[Options], object],
    arguments: Sequence[str] | None = None,
    prog: str | None = None,
    prepare: Callable[[Sequence[str]], Sequence[str]] = list,
) -> None:
    """Parse `options` from the command line, call `action`, exit.

    `--plugin FILE.py|MODULE` is an option of every command: what it names is imported before the
    others are read, so that they know what it registers. `prepare` turns into options what others
    than a user put on the command line. The exit status is what `action` returns
    where that is a number, else 0; 2 for bad input or a disk that is full or read-only, 130 after
    Ctrl-C.
    """
    tune()
    enable_compilation_cache()
    try:
        with warnings.catch_warnings():
            warnings.showwarning = _show(warnings.showwarning)
            arguments = prepare(sys.argv[1:] if arguments is None else arguments)
            _refuse_empty(arguments)
            _load_plugins(arguments)
            found = tyro.cli(with_plugins(options), args=arguments, prog=prog)
            names = [field.name for field in dataclasses.fields(options)]  # pyright: ignore
            status = action(options(**{name: getattr(found, name) for name in names}))
    except KeyboardInterrupt:
        # Threads that compile are waited for; who presses it again does not wait, nor see a trace.
        signal.signal(signal.SIGINT, signal.SIG_DFL)
        print("interrupted", file=sys.stderr)
        sys.exit(130)
    except Exception as error:
        if isinstance(error, InputError) or getattr(error, "errno", None) in OF_THE_DISK:
            print(f"error: {printable(str(error))}", file=sys.stderr)
            sys.exit(2)
        raise
    sys.exit(status if isinstance(status, int) else 0)


def with_plugins(options: type[Options]) -> type[Options]:
    """`options` with `--plugin` as one option more."""
    field = ("plugin", Plugins, dataclasses.field(default=()))
    return dataclasses.make_dataclass(
        options.__name__,
        [field],
        bases=(options,),
        frozen=True,
        namespace={"__doc__": options.__doc__, "__module__": options.__module__},
    )


def _show(otherwise: Callable[..., object]) -> Callable[..., None]:
    """How warnings are shown: those of the user's input in one line, others as before."""

    def show(message: Warning | str, category: type[Warning], *where: object) -> None:
        if issubclass(category, InputWarning):
            print(f"warning: {printable(str(message))}", file=sys.stderr)
        else:
            otherwise(message, category, *where)

    return show


def _refuse_empty(arguments: Sequence[str]) -> None:
    """InputError for an empty value, which as a path would be the current folder."""
    for name, value in zip(["the first argument", *arguments], arguments):
        if not value or (value.startswith("--") and value.endswith("=")):
            raise InputError(f"{value.removesuffix('=') or name}: is empty")


def _load_plugins(arguments: Sequence[str]) -> None:
    """Import the plugins of installed packages, and what `--plugin` names."""
    load_entry_points()
    for place, argument in enumerate(arguments):
        name, equals, plugin = argument.partition("=")
        if name == "--plugin" and (equals or place + 1 < len(arguments)):
            load_plugin(plugin if equals else arguments[place + 1])
