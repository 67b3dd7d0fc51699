"""Run a command: parse its options, and print errors of input in one line without a traceback."""

import argparse
import codecs
import contextlib
import difflib
import errno
import functools
import importlib
import inspect
import io
import itertools
import os
import re
import signal
import sys
import warnings
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NoReturn, TextIO

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
NESTED = re.compile(r"\[(\w+) \[\1 \.\.\.\]\]")
"""How tyro writes several values of one kind."""
REFUSALS = {
    r"Error parsing (\S+): invalid literal for int\(\) with base 10: (.*)": (
        r"\1: \2 is not a whole number"
    ),
    r"Error parsing (\S+): could not convert string to float: (.*)": (
        r"\1: \2 is not a number"
    ),
    r"Missing value for argument '(.*?)'.*": r"\1: its value is missing",
    r"invalid choice ('.*?') for argument '(.*?)'\. Expected one of \((.*?),?\)\.": (
        r"\2: \1 is none of \3"
    ),
}
"""What tyro says of a mistake, and what we say."""
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
        # To this stream: that of the parser is read, which prints a refusal in a box.
        warnings.showwarning = functools.partial(_show, stream=sys.stderr)
        words = sys.argv[1:] if arguments is None else arguments
        words = current_names(options, words)
        _refuse_odd_lists(options, words)
        arguments = load_plugins(with_file(options, prepare(words)))
        everything = "--help-all" in arguments
        if everything or {"-h", "--help"} & set(arguments):
            print(help_text(options, prog or "neurosym", everything))
            sys.exit(0)
        if action is None:  # A function, which the parser calls.
            enable_compilation_cache()
        value = _parsed(options, arguments, prog or "neurosym")
        if action is None:
            return value()
        if getattr(value, "needs_jax", True):
            enable_compilation_cache()
        return action(value)


def _parsed(options: Command, arguments: Sequence[str], prog: str) -> Any:
    """The dataclass `options` as the command line has it, or a call of the function `options`.

    Raises:
        InputError: in a line, for what tyro refuses in a box of several.
    """
    target: Any = options
    if not inspect.isclass(options):
        target = _call_of(options)

    printed = io.StringIO()
    try:
        with contextlib.redirect_stderr(printed):
            value = tyro.cli(
                target, args=arguments, prog=prog, config=(tyro.conf.DisallowNone,)
            )
    except SystemExit as end:
        if end.code == 2 and printed.getvalue():
            raise InputError(refusal(printed.getvalue(), options, prog)) from None
        print(printed.getvalue(), end="", file=sys.stderr)
        raise
    print(printed.getvalue(), end="", file=sys.stderr)
    return value


def _call_of(function: Callable[..., object]) -> Callable[..., object]:
    """A function of the same options that returns the call of `function`."""

    @functools.wraps(function)
    def call(*values: Any, **named: Any) -> Callable[[], object]:
        return functools.partial(function, *values, **named)

    return call


def refusal(box: str, options: Command, prog: str) -> str:
    """What tyro prints in a box, in one line that says what to do."""
    # In ASCII the title has a rule below it.
    _title, *lines = box.replace("│", " ").strip().splitlines()
    rest = itertools.dropwhile(_is_rule, lines)
    body = list(itertools.takewhile(lambda line: not _is_rule(line), rest))
    text = " ".join(line.strip() for line in body)
    help_of = f"{prog} --help"
    if text.startswith("Missing from"):
        needed: list[str] = []
        for line in body[1:]:
            # An option is indented by six, what it means by ten.
            if line.startswith(" " * 10):
                needed[-1] += f" {line.strip()}"
            elif line.startswith(" " * 6):
                needed.append(f"{line.strip()}:")
        texts = [NESTED.sub(r"\1 ...", each) for each in needed]
        texts = [each.removesuffix("(required)").rstrip(" .") for each in texts]
        return f"missing: {'; '.join(texts)} ({help_of})"
    for pattern, line in REFUSALS.items():
        match = re.match(pattern, text)
        if match:
            return f"{match.expand(line)} ({help_of})"
    if not text.startswith("Unrecognized options: "):
        return f"{text} ({help_of})"
    words = text.removeprefix("Unrecognized options: ").split(", ")
    if not words[0].startswith("-"):
        return f"not understood: {' '.join(words)} ({help_of})"
    names = [flag.split()[0] for _, flag, *_ in every_option(options)]
    names = [name for name in names if name.startswith("--")]
    name = flag_names(words)[0]
    nearest = difflib.get_close_matches(name, names, 1, 0.7)
    hint = f": did you mean {nearest[0]}?" if nearest else ""
    return f"{prog} has no option {name}{hint} ({help_of}-all lists all)"


def _is_rule(line: str) -> bool:
    """A line of a box that has no text."""
    return not line.strip(" -─╰╯")


def _refuse_odd_lists(options: Command, arguments: Sequence[str]) -> None:
    """Refuse an option of several values that stands twice, or without one where it needs one.

    The parser would drop the values of the first, or ignore the option. Of an option
    with one value the last counts, as everywhere. Where the default is not empty, as of
    `--baselines`, no value means an empty list.

    Raises:
        InputError: naming the first.
    """
    names = flag_names(arguments)
    for _, flag, _meaning, default in every_option(options):
        name, *value = flag.split()
        if value[-1:] != ["..."] or name not in names:
            continue
        if names.count(name) > 1:
            raise InputError(
                f"{name}: is given twice; give it once, with all its values"
            )
        place = names.index(name)
        has_value = "=" in arguments[place]
        following = arguments[place + 1 : place + 2]
        is_empty = not has_value and (not following or following[0].startswith("--"))
        if is_empty and default == ():
            raise InputError(f"{name}: its value is missing")


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


def _show(message: Warning | str, *_where: Any, stream: TextIO, **_more: Any) -> None:
    """Show a warning in one line."""
    print(f"warning: {printable(str(message))}", file=stream)
