"""Run a command: options are a dataclass, errors of input are one line without a traceback."""

import dataclasses
import errno
import signal
import sys
import warnings
from collections.abc import Callable, Sequence
from typing import Annotated, TypeVar

import tyro

from neurosym_jax.commands._help import short_help
from neurosym_jax.errors import InputError, InputWarning, printable
from neurosym_jax.plugins import load_entry_points, load_plugin
from neurosym_jax.runtime.process import enable_compilation_cache, tune

__all__ = ["run_command", "with_plugins"]

Options = TypeVar("Options")

OF_THE_DISK = (errno.ENOSPC, errno.EDQUOT, errno.EROFS, errno.EACCES, errno.EIO)
"""Errors of the disk, not of the code."""

PLUGIN = (
    "Your own file or module, imported first to register metrics, forecasters, poolings, "
    "weightings or formats; may be repeated."
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

    `--help` is short, `--help-all` explains every option. `--plugin FILE.py|MODULE` of every
    command is imported before the other options are parsed. `prepare` removes arguments that other
    programs add. The exit status is the integer that `action` returns, else 0; 2 for bad input or a
    full or read-only disk, 130 after Ctrl-C.
    """
    tune()
    enable_compilation_cache()
    try:
        with warnings.catch_warnings():
            warnings.showwarning = _show(warnings.showwarning)
            arguments = prepare(sys.argv[1:] if arguments is None else arguments)
            _refuse_empty(arguments)
            _load_plugins(arguments)
            if {"-h", "--help"} & set(arguments):
                print(short_help(options, prog or "neurosym"))
                sys.exit(0)
            arguments = ["--help" if each == "--help-all" else each for each in arguments]
            found = tyro.cli(
                with_plugins(options),
                args=arguments,
                prog=prog,
                config=(tyro.conf.DisallowNone,),
            )
            names = [field.name for field in dataclasses.fields(options)]  # pyright: ignore
            status = action(options(**{name: getattr(found, name) for name in names}))
    except KeyboardInterrupt:
        # Python waits for compiling threads; a second Ctrl-C ends the process at once.
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
    """`options` with the option `--plugin`."""
    field = ("plugin", Plugins, dataclasses.field(default=()))
    return dataclasses.make_dataclass(
        options.__name__,
        [field],
        bases=(options,),
        frozen=True,
        namespace={"__doc__": options.__doc__, "__module__": options.__module__},
    )


def _show(otherwise: Callable[..., object]) -> Callable[..., None]:
    """Show warnings about input in one line, others as before."""

    def show(message: Warning | str, category: type[Warning], *where: object) -> None:
        if issubclass(category, InputWarning):
            print(f"warning: {printable(str(message))}", file=sys.stderr)
        else:
            otherwise(message, category, *where)

    return show


def _refuse_empty(arguments: Sequence[str]) -> None:
    """Refuse an empty value, which as a path would be the current folder."""
    for name, value in zip(["the first argument", *arguments], arguments):
        if not value or (value.startswith("--") and value.endswith("=")):
            raise InputError(f"{value.removesuffix('=') or name}: is empty")


def _load_plugins(arguments: Sequence[str]) -> None:
    """Import the plugins of installed packages and those of `--plugin`."""
    load_entry_points()
    for place, argument in enumerate(arguments):
        name, equals, plugin = argument.partition("=")
        if name == "--plugin" and (equals or place + 1 < len(arguments)):
            load_plugin(plugin if equals else arguments[place + 1])
