"""From a command line to a call: options are a dataclass, bad input is one line, not a trace."""

import sys
import traceback
import warnings
from collections.abc import Callable, Sequence
from typing import TypeVar

import tyro

from neurosym_jax.distributed import leave
from neurosym_jax.errors import InputError, InputWarning
from neurosym_jax.runtime import enable_compilation_cache, tune

__all__ = ["run_command"]

Options = TypeVar("Options")


def run_command(
    options: type[Options],
    action: Callable[[Options], object],
    arguments: Sequence[str] | None = None,
    prog: str | None = None,
) -> None:
    """Parse `options` from the command line, call `action`, exit.

    The exit status is what `action` returns where that is a number, else 0; 2 for bad input.
    """
    tune()
    enable_compilation_cache()
    try:
        with warnings.catch_warnings():
            warnings.showwarning = _show(warnings.showwarning)
            status = action(tyro.cli(options, args=arguments, prog=prog))
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
