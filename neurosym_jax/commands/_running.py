"""Run a command: parse its options, and print errors of input in one line without a traceback."""

import argparse
import codecs
import contextlib
import errno
import importlib
import io
import os
import signal
import sys
import warnings
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NoReturn

import tyro

from neurosym_jax.commands._options import (
    Command,
    current_names,
    every_option,
    flag_names,
    help_text,
    with_file,
)
from neurosym_jax.errors import InputError, printable, spoken_as_flags
from neurosym_jax.plugins import load_entry_points, load_plugin
from neurosym_jax.runtime.ending import interruptible
from neurosym_jax.runtime.process import enable_compilation_cache, tune

__all__ = ["load_plugins", "print_completion", "run_command"]

OF_THE_DISK = (errno.ENOSPC, errno.EDQUOT, errno.EROFS, errno.EACCES, errno.EIO)
"""Errors of the disk, not of the code."""
JAX_NOTE = "JAX has removed its internal frames"
"""What JAX adds to an error that passes through a program; here no traceback is shown."""
SHELLS = ("bash", "zsh", "fish")
IN_ASCII = str.maketrans({"±": "+-", "−": "-"})


def run_command(
    options: Command,
    action: Callable[[Any], object] | None = None,
    arguments: Sequence[str] | None = None,
    prog: str | None = None,
    prepare: Callable[[Sequence[str]], Sequence[str]] = list,
) -> None:
    """Run a command on the command line or a file in YAML, and exit.

    `options` is the dataclass that `action` takes, or without `action` a function of
    the options. Options whose `needs_jax` is false run without JAX. `prepare` removes
    arguments that other programs add. The exit status is the integer that is returned,
    else 0; 2 for bad input or a full or read-only disk; 128 and the number of the
    signal that ended it, such as 130 after Ctrl-C.
    """
    tune()
    _write_any_text()
    with spoken_as_flags(), interruptible() as signals:
        try:
            status = _run(options, action, arguments, prog, prepare)
        except BaseException as error:
            # A library may have made another error of the interruption.
            if signals:
                _end(128 + signals[0])
            if isinstance(error, KeyboardInterrupt):
                print("interrupted", file=sys.stderr)
                sys.exit(128 + signal.SIGINT)
            of_the_disk = getattr(error, "errno", None) in OF_THE_DISK
            if isinstance(error, InputError) or of_the_disk:
                print(f"error: {printable(str(error))}", file=sys.stderr)
                for note in getattr(error, "__notes__", ()):
                    if JAX_NOTE not in note:
                        lines = map(printable, note.splitlines())
                        print("\n".join(lines), file=sys.stderr)
                sys.exit(2)
            raise
    if signals:  # The action has ended by itself.
        _end(128 + signals[0])
    sys.exit(status if isinstance(status, int) else 0)


def _write_any_text() -> None:
    """Print letters that a terminal's encoding lacks in other letters, such as +- for ±."""
    codecs.register_error("neurosym", _in_ascii)
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="neurosym")


def _in_ascii(error: UnicodeError) -> tuple[str, int]:
    """The letters that cannot be written in ASCII, and where they end."""
    if not isinstance(error, UnicodeEncodeError):
        raise error
    text = error.object[error.start : error.end].translate(IN_ASCII)
    return text.encode("ascii", "backslashreplace").decode("ascii"), error.end


def _end(status: int) -> NoReturn:
    """End the process without the end of Python, which aborts where a thread compiles meanwhile."""
    with contextlib.suppress(OSError, ValueError):
        sys.stdout.flush()
        sys.stderr.flush()
    os._exit(status)


def _run(
    options: Command,
    action: Callable[[Any], object] | None,
    arguments: Sequence[str] | None,
    prog: str | None,
    prepare: Callable[[Sequence[str]], Sequence[str]],
) -> object:
    """Parse the options and call the action; returns what it returns."""
    with warnings.catch_warnings():
        warnings.showwarning = _show
        words = sys.argv[1:] if arguments is None else arguments
        words = current_names(options, words)
        _refuse_repeated(options, words)
        arguments = load_plugins(with_file(options, prepare(words)))
        everything = "--help-all" in arguments
        if everything or {"-h", "--help"} & set(arguments):
            print(help_text(options, prog or "neurosym", everything))
            sys.exit(0)
        if action is None:  # A function, which the parser calls.
            enable_compilation_cache()
        value = tyro.cli(
            options,
            args=arguments,
            prog=prog,
            config=(tyro.conf.DisallowNone,),
        )
        if action is None:
            return value
        if getattr(value, "needs_jax", True):
            enable_compilation_cache()
        return action(value)


def _refuse_repeated(options: Command, arguments: Sequence[str]) -> None:
    """Refuse a list of values that stands twice: the parser would drop those of the first.

    Of an option with one value the last counts, as everywhere.

    Raises:
        InputError: naming the first.
    """
    names = flag_names(arguments)
    for _, flag, *_ in every_option(options):
        name, *value = flag.split()
        if value[-1:] == ["..."] and names.count(name) > 1:
            raise InputError(
                f"{name}: is given twice; give it once, with all its values"
            )


def print_completion(modules: Mapping[str, str], shell: str) -> None:
    """Print a script by which a shell completes commands and their options.

    Args:
        modules: module of each command, by name.
        shell: bash, zsh or fish.
    """
    if shell not in SHELLS:
        sys.exit(f"error: --completion {shell}: one of {', '.join(SHELLS)}")
    subcommands: dict[str, Command] = {}
    for name, module in modules.items():
        command = importlib.import_module(module)
        subcommands[name] = getattr(command, "Options", command.run)
    script = io.StringIO()
    try:
        with contextlib.redirect_stdout(script):
            tyro.extras.subcommand_cli_from_dict(
                subcommands,
                prog="neurosym",
                args=["--tyro-print-completion", shell],
                config=(tyro.conf.DisallowNone,),
            )
    except SystemExit as end:
        if end.code:  # This tyro has no script for the shell, and has said so.
            raise
    for line in script.getvalue().splitlines():
        if line.startswith("COMPLETION_SPEC = "):
            # tyro's script takes each line of a description for a word to complete.
            line = line.replace(r"\n", " ")
        print(line)


def load_plugins(arguments: Sequence[str]) -> list[str]:
    """Import installed plugins and those that `--plugin` names; returns the other arguments.

    Raises:
        InputError: for an empty argument, which as a path would be the current folder.
    """
    for name, value in zip(["the first argument", *arguments], arguments):
        if not value or (value.startswith("--") and value.endswith("=")):
            raise InputError(f"{value.removesuffix('=') or name}: is empty")
    parser = argparse.ArgumentParser(add_help=False, allow_abbrev=False)
    parser.add_argument("--plugin", action="append", default=[])
    namespace, others = parser.parse_known_args(arguments)
    load_entry_points()
    for plugin in namespace.plugin:
        load_plugin(plugin)
    return others


def _show(message: Warning | str, *_where: Any, **_more: Any) -> None:
    """Show a warning in one line."""
    print(f"warning: {printable(str(message))}", file=sys.stderr)
