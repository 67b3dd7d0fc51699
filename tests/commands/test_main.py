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
from neurosym_jax.commands._options import short_help
from neurosym_jax.commands.evaluate import Options
from tests.repository import ROOT, run_python

NAMES = re.compile(r"--[a-z][a-z0-9.-]*")
HEAVY = {"jax", "flax", "matplotlib", "numpy", "optax", "rosbags", "scipy", "tyro"}

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


@pytest.mark.parametrize("name", commands())
def test_help_fits_a_screen_and_names_every_option(name, capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "90")
    module = importlib.import_module(commands()[name])
    options = getattr(module, "Options", module.run)
    text = short_help(options, f"neurosym {name}")
    lines = text.splitlines()
    assert len(lines) <= 52
    assert max(map(len, lines)) <= 90
    with pytest.raises(SystemExit):
        tyro.cli(options, args=["--help"])
    flags = set(
        re.findall(r"^│ (--[a-z][a-z0-9.-]*)", capsys.readouterr().out, re.MULTILINE)
    )
    assert flags - set(NAMES.findall(text)) == set()
    assert set(NAMES.findall(text)) >= {"--plugin", "--help-all"}


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
        r"--figures +Draw figures \(default; --no-figures\)", short_help(Options, "")
    )
    with pytest.raises(SystemExit):
        main(["symbols", "--help-all"])
    assert "{None}" not in capsys.readouterr().out
