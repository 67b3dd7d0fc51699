"""Every option that a page names is one of its command."""

import importlib
import io
import re
from contextlib import redirect_stdout

import pytest
import tyro

from neurosym_jax.__main__ import commands
from studies.check_docs import commands as named_commands

NAMED = sorted(set(named_commands()))


def options(name: str) -> set[str]:
    """The options in the help of a command."""
    module = importlib.import_module(commands()[name])
    text = io.StringIO()
    with redirect_stdout(text), pytest.raises(SystemExit):
        tyro.cli(module.Options, args=["--help"])
    return {"--plugin", "--help-all", *re.findall(r"--[a-z][a-z0-9.-]*", text.getvalue())}


def test_what_is_named_is_there():
    assert len(NAMED) > 40
    known = {name: options(name) for name in commands()}
    wrong = []
    for page, command in NAMED:
        name, *words = command.split()[1:]
        if name.startswith("-") or not name.islower():
            continue
        used = {word.partition("=")[0] for word in words if re.match(r"--[a-z]", word)}
        used = {word.rstrip(",.;:").replace("_", "-") for word in used}
        wrong += [(str(page), command)] if name not in known or used - known[name] else []
    assert wrong == []
