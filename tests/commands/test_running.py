"""Processes of commands: exit status and plugins."""

import builtins
import dataclasses
import io
import os
import subprocess
import sys
import warnings

import jax
import pytest

from neurosym_jax.commands._running import run_command
from neurosym_jax.commands.evaluate import Options
from neurosym_jax.errors import InputError, InputWarning
from tests.repository import ROOT


@pytest.fixture(autouse=True)
def no_cache(monkeypatch):
    monkeypatch.setenv("NEUROSYM_NO_CACHE", "1")


def raising(error):
    def action(options):
        raise error

    return action


def raising_in_a_program(options):
    # JAX adds a note on its own frames to what passes through it.
    jax.jit(raising(InputError("no")))(1.0)


@pytest.mark.parametrize(
    ("action", "status", "line"),
    [
        (lambda options: None, 0, ""),
        (lambda options: [1], 0, ""),
        (lambda options: 3, 3, ""),
        (raising(InputError("no")), 2, "error: no\n"),
        (raising_in_a_program, 2, "error: no\n"),
        (raising(KeyboardInterrupt()), 130, "interrupted\n"),
        (raising(OSError(28, "No space")), 2, "error: [Errno 28] No space\n"),
    ],
)
def test_exit_status(capsys, action, status, line):
    with pytest.raises(SystemExit) as caught:
        run_command(Options, action, [])
    assert caught.value.code == status
    assert capsys.readouterr().err == line


@dataclasses.dataclass(frozen=True)
class Outdated:
    """Options whose defaults warn while they are parsed."""

    width: int = dataclasses.field(default_factory=lambda: warned(3))


def warned(value):
    warnings.warn("a default of old", InputWarning, stacklevel=2)
    return value


@pytest.mark.parametrize(
    ("words", "line"),
    [
        (["--width", "x"], "error: --width: 'x' is not a whole number"),
        (["--widht", "3"], "error: neurosym has no option --widht"),
    ],
)
def test_warnings_of_the_parser_stand_before_its_refusal(words, line, capsys):
    with pytest.raises(SystemExit):
        run_command(Outdated, print, words)
    *shown, refusal = capsys.readouterr().err.splitlines()
    assert set(shown) == {"warning: a default of old"}
    assert refusal.startswith(line)


def test_an_error_of_ours_is_a_traceback():
    with pytest.raises(ValueError, match="ours"):
        run_command(Options, raising(ValueError("ours")), [])


def test_a_plugin_comes_first_and_options_are_those_of_the_command(tmp_path):
    plugin = tmp_path / "mine.py"
    plugin.write_text("import builtins\nbuiltins.plugin_of_a_test = True\n")
    messages = []
    with pytest.raises(SystemExit):
        run_command(
            Options, messages.append, ["--plugin", str(plugin), "--samples", "3"]
        )
    assert messages == [Options(samples=3)]
    assert type(messages[0]) is Options
    assert builtins.__dict__.pop("plugin_of_a_test")


@pytest.mark.slow
def test_a_real_process(tmp_path):
    (tmp_path / "tracks.csv").write_text("0,1,2,3\n1,1,2,oops\n")
    # An environment that only finds the packages: nothing that sets up jax.
    environment = {
        "JAX_PLATFORMS": "cpu",
        "PATH": os.environ["PATH"],
        "HOME": str(tmp_path),
        "PYTHONPATH": str(ROOT),
    }
    command = [sys.executable, str(ROOT / "evaluate.py"), "--data", "tracks.csv"]
    capture = {"capture_output": True, "text": True, "check": False}
    done = subprocess.run(command, cwd=tmp_path, env=environment, **capture)
    message = "error: tracks.csv: row 2: y is not a number: 'oops'\n"
    assert (done.returncode, done.stdout, done.stderr) == (2, "", message)
    assert not list(tmp_path.glob("results/*"))


@pytest.mark.parametrize(
    ("encoding", "line"), [("ascii", "+-.1 -2 \\xd6"), ("utf-8", "±.1 −2 Ö")]
)
def test_a_terminal_without_these_letters_gets_others(encoding, line, monkeypatch):
    file = io.BytesIO()
    monkeypatch.setattr(sys, "stdout", io.TextIOWrapper(file, encoding))
    with pytest.raises(SystemExit) as end:
        run_command(lambda: print("±.1 −2 Ö"), arguments=[])
    sys.stdout.flush()
    assert end.value.code == 0
    assert file.getvalue().decode(encoding) == f"{line}\n"
