"""`neurosym`: the list of commands costs nothing, a wrong name gets a hint."""

import importlib
import os
import subprocess
import sys
from pathlib import Path
from types import ModuleType

import pytest

from neurosym_jax.__main__ import commands, main

HEAVY = {"jax", "flax", "matplotlib", "numpy", "optax", "orbax", "rosbags", "scipy", "tyro"}

ROOT = Path(__file__).parents[2]
PACKAGES = [
    ".".join(path.parent.relative_to(ROOT).parts)
    for path in ROOT.glob("neurosym_*/**/__init__.pyi")
]


def imported_by(script):
    """Those of `HEAVY` that a fresh process has imported after `script`."""
    script += f"\nimport sys; print('imported:', *{HEAVY} & sys.modules.keys())"
    done = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, check=True
    )
    return done.stdout.split("imported:")[1].split()


@pytest.mark.parametrize(
    "script",
    [
        "from neurosym_jax.__main__ import main; main(['--help'])",
        "from neurosym_jax.__main__ import main; main(['--version'])",
        f"import {', '.join(PACKAGES)}; dir(neurosym_jax)",
    ],
)
def test_nothing_heavy_is_imported_before_it_is_asked_for(script):
    assert imported_by(script) == []


def test_what_is_asked_for_is_imported():
    assert "jax" in imported_by("import neurosym_jax; neurosym_jax.symbolic.observe")


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


def test_help_lists_every_command(capsys):
    main(["--help"])
    lines = capsys.readouterr().out.splitlines()
    for name in commands():
        (line,) = (line for line in lines if line.startswith(f"  {name} "))
        assert len(line.split()) > 2
        assert len(line) <= 80


def test_no_argument_is_a_question_for_help(capsys):
    main([])
    assert capsys.readouterr().out.startswith("usage: neurosym COMMAND")


def test_who_reads_may_stop_reading():
    reads, writes = os.pipe()
    os.close(reads)
    command = [sys.executable, "-m", "neurosym_jax", "--help"]
    with open(writes, "w") as pipe:
        done = subprocess.run(command, stdout=pipe, stderr=subprocess.PIPE, check=False)
    assert (done.returncode, done.stderr) == (1, b"")


def test_a_wrong_name_gets_a_hint():
    with pytest.raises(SystemExit, match="no command 'evalute': did you mean evaluate"):
        main(["evalute"])
