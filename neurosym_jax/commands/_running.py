"""From a command line to a call: options are a dataclass, bad input is one line, not a trace."""

import inspect
import sys
import traceback
import warnings
from collections.abc import Callable, Sequence
from typing import TypeVar

import tyro

from neurosym_jax.errors import InputError, InputWarning
from neurosym_jax.plugins import load_plugin
from neurosym_jax.runtime.process import enable_compilation_cache, tune
from neurosym_jax.runtime.processes import leave

__all__ = ["run_command"]

Options = TypeVar("Options")

PLUGIN = (
    "--plugin FILE.py|MODULE, as often as wanted, imports what is named first: a file of one's own "
    "that registers metrics, forecasters, poolings, weightings or formats."
)


def run_command(
    options: type[Options],
    action: Callable[[Options], object],
    arguments: Sequence[str] | None = None,
    prog: str | None = None,
) -> None:
    """Parse `options` from the command line, call `action`, exit.

    `--plugin FILE.py|MODULE` is an option of every command: what it names is imported before the
    others are read, so that they know what it registers. The exit status is what `action` returns
    where that is a number, else 0; 2 for bad input.
    """
    tune()
    enable_compilation_cache()
    try:
        with warnings.catch_warnings():
            warnings.showwarning = _show(warnings.showwarning)
            rest = _load_plugins(sys.argv[1:] if arguments is None else arguments)
            text = f"{inspect.getdoc(options)}\n\n{PLUGIN}"
            status = action(tyro.cli(options, args=rest, prog=prog, description=text))
    except InputError as error:
        print(f"error: {error}", file=sys.stderr)
        leave(2)
        sys.exit(2)
    except Exception:
        leave(1, traceback.format_exc())
        raise
    sys.exit(status if isinstance(status, int) else 0)


def _show(otherwise: Callable[..., object]) -> Callable[..., None]:
    """How warnings are shown: those of the user's input in one line, others as before."""

    def show(message: Warning | str, category: type[Warning], *where: object) -> None:
        if issubclass(category, InputWarning):
            print(f"warning: {message}", file=sys.stderr)
        else:
            otherwise(message, category, *where)

    return show


def _load_plugins(arguments: Sequence[str]) -> list[str]:
    """Import what `--plugin` names; returns the other arguments."""
    rest: list[str] = []
    waiting = list(arguments)
    while waiting:
        name, equals, plugin = waiting.pop(0).partition("=")
        if name != "--plugin":
            rest.append(name + equals + plugin)
        elif plugin or waiting:
            load_plugin(plugin or waiting.pop(0))
        else:
            raise InputError("--plugin needs the path of a .py file, or a module's name")
    return rest
