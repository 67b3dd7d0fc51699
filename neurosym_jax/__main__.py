"""`neurosym COMMAND` and `python -m neurosym_jax COMMAND`: each file in `commands/` is a command.

A command's file has `Options`, a dataclass, and `run(options)`; `PREPARE` where others than users
write its command lines (see `commands/_running.py`). The first line of its text is what
the list of commands says. It is imported when it is asked for.
"""

import ast
import importlib
import os
import sys
from importlib.resources import files

__all__ = ["command_names", "main"]

COMMANDS = "neurosym_jax.commands"


def command_names() -> list[str]:
    """The commands there are, in order of name."""
    return sorted(
        file.name.removesuffix(".py")
        for file in files(COMMANDS).iterdir()
        if file.name.endswith(".py") and not file.name.startswith("_")
    )


def main(arguments: list[str] | None = None) -> None:
    """Run the command that `arguments` name, by default those of the command line."""
    try:
        _run(sys.argv[1:] if arguments is None else arguments)
        sys.stdout.flush()
    except KeyboardInterrupt:  # while a command's modules are imported
        print("interrupted", file=sys.stderr)
        sys.exit(130)
    except BrokenPipeError:
        # Who reads what is printed, such as `head`, has seen enough: neither is the rest written at
        # the end.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        sys.exit(1)


def _run(arguments: list[str]) -> None:
    name, *rest = arguments or ["--help"]
    names = command_names()
    if name in ("-h", "--help"):
        print(_usage(names))
    elif name == "--version":
        from importlib.metadata import version

        print(f"neurosym {version('neurosym-jax')}")
    elif name in names:
        command = importlib.import_module(f"{COMMANDS}.{name}")
        from neurosym_jax.commands._running import run_command

        prepare = getattr(command, "PREPARE", list)
        run_command(command.Options, command.run, rest, f"neurosym {name}", prepare)
    else:
        import difflib

        nearest = difflib.get_close_matches(name, names, 1)
        hint = f"did you mean {nearest[0]}?" if nearest else "neurosym --help lists them"
        sys.exit(f"error: there is no command {name!r}: {hint}")


def _usage(names: list[str]) -> str:
    width = max(map(len, names))
    lines = [f"  {name:{width}}  {_summary(name)}" for name in names]
    return "usage: neurosym COMMAND [--help]\n       neurosym --version\n\n" + "\n".join(lines)


def _summary(name: str) -> str:
    """What a command does, without importing it."""
    text = files(COMMANDS).joinpath(f"{name}.py").read_text(encoding="utf-8")
    first = (ast.get_docstring(ast.parse(text)) or "").split("\n")[0]
    return first.rstrip(".")


if __name__ == "__main__":
    main()
