"""`neurosym COMMAND` and `python -m neurosym_jax COMMAND`: each file in `commands/` is a command.

Other packages add theirs by entry points in the group `neurosym_jax.commands`. A
command's file has a function `run`, whose parameters are the options or, where it has a
dataclass `Options`, that; and sometimes `prepare_arguments` (see
`commands/_running.py`). The first line of its docstring is its line in the list. It is
imported only when it is called.
"""

import ast
import difflib
import importlib
import importlib.util
import os
import sys
from importlib.resources import files
from pathlib import Path

from neurosym_jax.plugins import entry_points, installed_version

__all__ = ["commands", "main"]

COMMANDS = "neurosym_jax.commands"


def commands() -> dict[str, str]:
    """Module of each command, by name in alphabetical order."""
    names = [file.name.removesuffix(".py") for file in files(COMMANDS).iterdir()]
    modules = {**entry_points("commands")}
    for name in names:
        if not name.startswith("_"):
            modules[name.replace("_", "-")] = f"{COMMANDS}.{name}"
    return dict(sorted(modules.items()))


def main(arguments: list[str] | None = None) -> None:
    """Run the command that `arguments` name, by default those of the command line."""
    try:
        _run(sys.argv[1:] if arguments is None else arguments)
        sys.stdout.flush()
    except KeyboardInterrupt:  # while a command's modules are imported
        print("interrupted", file=sys.stderr)
        sys.exit(130)
    except BrokenPipeError:
        # The reader, such as `head`, has closed the pipe; Python must not flush to it
        # at exit.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        sys.exit(1)


def _run(arguments: list[str]) -> None:
    name, *rest = arguments or ["--help"]
    modules = commands()
    if name in ("-h", "--help"):
        print("usage: neurosym COMMAND [--help]\n       neurosym --version")
        print("       neurosym --completion bash|zsh|fish\n")
        width = max(map(len, modules))
        for command, module in modules.items():
            print(f"  {command:{width}}  {_summary(module)}")
    elif name == "--version":
        print(f"neurosym {installed_version()}")
    elif name == "--completion":
        from neurosym_jax.commands._running import print_completion

        print_completion(modules, " ".join(rest))
    elif name in modules:
        command = importlib.import_module(modules[name])
        from neurosym_jax.commands._running import run_command

        prepare = getattr(command, "prepare_arguments", list)
        options, action = command.run, None
        if hasattr(command, "Options"):
            options, action = command.Options, command.run
        run_command(options, action, rest, f"neurosym {name}", prepare)
    else:
        nearest = difflib.get_close_matches(name, modules, 1)
        hint = (
            f"did you mean {nearest[0]}?" if nearest else "neurosym --help lists them"
        )
        sys.exit(f"error: there is no command {name!r}: {hint}")


def _summary(module: str) -> str:
    """First line of a command's docstring, read without importing the command."""
    try:
        spec = importlib.util.find_spec(module)
    except ImportError:  # An entry point stays when its package is removed.
        spec = None
    if spec is None or spec.origin is None:
        return f"(not found: {module})"
    tree = ast.parse(Path(spec.origin).read_text(encoding="utf-8"))
    return (ast.get_docstring(tree) or "").split("\n")[0].rstrip(".")


if __name__ == "__main__":
    main()
