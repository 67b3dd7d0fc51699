"""`neurosym`: the list of commands costs nothing, a wrong name gets a hint, help fits a screen."""

import importlib
import os
import re
import subprocess
import sys
from pathlib import Path
from types import ModuleType

import pytest
import tyro

from neurosym_jax.__main__ import commands, main
from neurosym_jax.commands._options import every_option, help_text
from tests.repository import ROOT, run_python

NAMES = re.compile(r"--[a-z][a-z0-9.-]*")
HEAVY = {"jax", "flax", "matplotlib", "numpy", "optax", "rosbags", "scipy", "tyro"}

LIVE = [
    name for name in ("replay", "ros1", "ros2") if "robot" in commands().get(name, "")
]
PACKAGES = [
    ".".join(path.parent.relative_to(ROOT).parts)
    for path in ROOT.glob("neurosym_*/**/__init__.pyi")
]


@pytest.mark.parametrize(
    ("script", "heavy"),
    [
        ("from neurosym_jax.__main__ import main; main(['--help'])", False),
        ("from neurosym_jax.__main__ import main; main(['--version'])", False),
        (f"import {', '.join(PACKAGES)}; dir(neurosym_jax)", False),
        ("import neurosym_jax; neurosym_jax.symbolic.observe", True),
    ],
)
def test_nothing_heavy_is_imported_before_it_is_asked_for(script, heavy):
    """The script runs in a fresh process, and sets no variable of its environment."""
    script = f"import os; before = dict(os.environ)\n{script}\nassert before == dict(os.environ)"
    script += f"\nimport sys; print('imported:', *{HEAVY} & sys.modules.keys())"
    imported = run_python("-c", script).stdout.split("imported:")[1].split()
    assert ("jax" in imported) == bool(imported) == heavy


@pytest.mark.parametrize("package", PACKAGES)
def test_every_export_is_there(package):
    module = importlib.import_module(package)
    assert module.__doc__
    modules = {path.stem for path in Path(module.__path__[0]).iterdir()}
    for name in module.__all__:
        exported = getattr(module, name)
        # One name cannot be a module and what is in it.
        assert isinstance(exported, ModuleType) == (name in modules)
        assert name in dir(module)
    with pytest.raises(AttributeError, match="no_such_thing"):
        _ = module.no_such_thing


@pytest.mark.parametrize("arguments", [["--help"], []])
def test_help_lists_every_command(arguments, capsys):
    main(arguments)
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].startswith("usage: neurosym COMMAND")
    for name in commands():
        (line,) = (line for line in lines if line.startswith(f"  {name} "))
        assert len(line.split()) > 2
        assert len(line) <= 80


def test_help_may_be_piped_into_a_reader_that_stops():
    reads, writes = os.pipe()
    os.close(reads)
    command = [sys.executable, "-m", "neurosym_jax", "--help"]
    with open(writes, "w") as pipe:
        done = subprocess.run(command, stdout=pipe, stderr=subprocess.PIPE, check=False)
    assert (done.returncode, done.stderr) == (1, b"")


def test_a_wrong_name_gets_a_hint():
    with pytest.raises(SystemExit, match="no command 'evalute': did you mean evaluate"):
        main(["evalute"])


@pytest.mark.slow  # It imports every command.
def test_a_shell_completes_commands_and_options(tmp_path):
    """In a bash, which asks for the words after `neurosym ev` and `neurosym train --fam`."""
    script = run_python("-m", "neurosym_jax", "--completion", "bash").stdout
    (tmp_path / "neurosym").write_text(script)
    lines = [f"source {tmp_path / 'neurosym'}", "complete -p neurosym"]
    for words in ("ev", "train --fam", "evaluate --table la"):
        given = ["neurosym", *words.split()]
        lines.append(f"COMP_WORDS=({' '.join(given)}); COMP_CWORD={len(given) - 1}")
        lines.append('COMPREPLY=(); _tyro_neurosym; echo "${COMPREPLY[*]}"')
    bash = subprocess.run(
        ["bash", "-c", "\n".join(lines)], capture_output=True, text=True, check=True
    )
    registered, *completions = bash.stdout.splitlines()
    assert registered == "complete -F _tyro_neurosym neurosym"
    assert completions == ["evaluate", "--family", "latex"]


def test_an_unknown_shell_is_refused():
    with pytest.raises(SystemExit, match="--completion csh: one of bash, zsh, fish"):
        main(["--completion", "csh"])


@pytest.mark.parametrize("name", commands())
def test_help_fits_a_screen_and_names_every_option(name, capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "90")
    module = importlib.import_module(commands()[name])
    options = getattr(module, "Options", module.run)
    text = help_text(options, f"neurosym {name}")
    lines = text.splitlines()
    assert len(lines) <= 52
    assert max(map(len, lines)) <= 90
    with pytest.raises(SystemExit):
        tyro.cli(options, args=["--help"])
    flags = set(
        re.findall(r"^[│ ] (--[a-z][a-z0-9.-]*)", capsys.readouterr().out, re.MULTILINE)
    )
    assert flags - set(NAMES.findall(text)) == set()
    assert set(NAMES.findall(text)) >= {"--plugin", "--help-all"}
    everything = help_text(options, f"neurosym {name}", everything=True)
    explained = re.findall(r"^  (--[a-z][a-z0-9.-]*)", everything, re.MULTILINE)
    # Each once, in the one group that it is in.
    assert sorted(explained) == sorted(flags | {"--plugin"})


@pytest.mark.parametrize("name", ["train", "sweep", "evaluate", *LIVE])
def test_eight_options_are_explained_first_and_all_have_a_group(name, monkeypatch):
    monkeypatch.setenv("COLUMNS", "90")
    options = importlib.import_module(commands()[name]).Options
    text = help_text(options, f"neurosym {name}")
    explained = re.findall(r"^  (--[a-z-]+|[A-Z]+) ", text, re.MULTILINE)
    first = options.FIRST.split()
    wanted = [f"--{field.replace('_', '-')}" for field in first]
    names = {flag.split()[0] for _, flag, *_ in every_option(options)}
    assert len(explained) <= 8
    for flag in wanted:
        # A positional one is in capitals, and `message` is of ROS 2 alone.
        is_there = flag in names or flag[2:].upper() in names
        assert is_there or flag == "--message"
        assert not is_there or {flag, flag[2:].upper()} & set(explained)
    titles = re.findall(r"^([a-z]+):", text.partition("\n")[2], re.MULTILINE)
    assert titles == ["data", "model", "output", "advanced"]


def test_help_says_what_the_main_options_do(capsys):
    with pytest.raises(SystemExit) as done:
        main(["symbols", "--help"])
    assert done.value.code in (0, None)
    text = capsys.readouterr().out
    assert text.startswith("usage: neurosym symbols DATA [OPTIONS]\n")
    assert re.search(r"--window N +Index of the window to show\.", text)
    assert re.search(
        r"--samples N +Number of forecasts of the scene, k \(default 20\)\.", text
    )
    assert re.search(r"--seed N +Random seed of the noise \(default 0\)\.", text)
    assert re.search(r"--forecast +Show [^(]*with\s+probabilities\.", text)
    assert re.search(
        r"--out PATH +Folder of the figures, or FILE\.csv: .*\s.*\(default results",
        text,
    )
    with pytest.raises(SystemExit):
        main(["evaluate", "--help-all"])
    text = capsys.readouterr().out
    assert re.search(r"--figures +Draw figures \(default; --no-figures\)", text)
    assert re.search(r"--json PATH +File of the report; rows are kept beside", text)
