"""Bad input through the command line: one clear line, a status of 2, never a traceback."""

import builtins
import os
import subprocess
import sys
from pathlib import Path

import pytest

from neurosym_jax.commands._running import run_command
from neurosym_jax.commands.evaluate import Options, run
from neurosym_jax.errors import InputError

ROOT = Path(__file__).parents[2]
GOOD = "\n".join(f"{frame} {ped} {frame} {ped}" for frame in range(20) for ped in (1, 2))
FILES = {
    "walks/walk.txt": GOOD.encode(),
    "word.txt": b"0 1 2 3\n1 1 2 abc\n",
    "corrupt.pt": b"PK\x03\x04" + bytes(range(256)),
    "thesis": b"my thesis",
    "rows.jsonl": b"my notes",
}
REFUSALS = {
    "--data absent": "absent: no such file or folder",
    "--data eth-ucy": "eth-ucy: no such file or folder: `neurosym download eth-ucy` fetches",
    "--data word.txt": "word.txt: row 2: y is not a number: 'abc'",
    "--data walks --dataset zara9": "unknown dataset 'zara9'",
    "--data walks --pred-len 999": "no 1007 consecutive steps",
    "--checkpoint absent.pt": "absent.pt: no such checkpoint",
    "--checkpoint corrupt.pt": "corrupt.pt: ",
    "--checkpoint walks": "it has no config.json",
    "--samples 0": "--samples must be at least 1, not 0",
    "--seed 4294967296": "--seed must lie in",
    "--period 0": "the period must be positive, not 0",
    "--metrics crsp": "unknown metric 'crsp': did you mean 'crps'?",
    "--baselines nobody": "unknown forecaster 'nobody'",
    "--baselines": "there is nothing to evaluate",
    "--save-forecasts f.csv": "f.csv: forecasts are written as .npz, .ndjson",
    "--json thesis": "thesis: is not a report of ours, so it is not overwritten",
    "--json rows.json": "rows.jsonl: is not a report of ours",
    "--cluster nowhere://x": "--cluster nowhere://x: no Dask scheduler answers",
    "--figures --plots thesis": "thesis: is not a folder",
    "--data=": "--data: is empty",
}


@pytest.fixture
def evaluate(tmp_path, monkeypatch, capsys):
    """Runs evaluate's command in a folder with `FILES`; gives its status and the error's line."""
    monkeypatch.setenv("NEUROSYM_NO_CACHE", "1")
    monkeypatch.setenv("NEUROSYM_DATA", str(tmp_path / "data"))
    monkeypatch.chdir(tmp_path)
    (tmp_path / "walks").mkdir()
    for name, content in FILES.items():
        (tmp_path / name).write_bytes(content)

    def command(*arguments):
        with pytest.raises(SystemExit) as caught:
            run_command(Options, run, ["--no-figures", "--json", "report.json", *arguments])
        out, err = capsys.readouterr()
        assert out == ""
        (line,) = (line for line in err.splitlines() if not line.startswith("warning"))
        assert not (tmp_path / "report.json").exists()
        return caught.value.code, line

    return command


@pytest.mark.parametrize("arguments", REFUSALS)
def test_refused(evaluate, arguments):
    status, line = evaluate(*arguments.split())
    assert status == 2
    assert line.startswith("error: ")
    assert REFUSALS[arguments] in line


def raising(error):
    def action(options):
        raise error

    return action


@pytest.mark.parametrize(
    ("action", "status", "line"),
    [
        (lambda options: None, 0, ""),
        (lambda options: [1], 0, ""),
        (lambda options: 3, 3, ""),
        (raising(InputError("no")), 2, "error: no\n"),
        (raising(KeyboardInterrupt()), 130, "interrupted\n"),
        (raising(OSError(28, "No space")), 2, "error: [Errno 28] No space\n"),
    ],
)
def test_exit_status(monkeypatch, capsys, action, status, line):
    monkeypatch.setenv("NEUROSYM_NO_CACHE", "1")
    with pytest.raises(SystemExit) as caught:
        run_command(Options, action, [])
    assert caught.value.code == status
    assert capsys.readouterr().err == line


def test_an_error_of_ours_is_a_traceback(monkeypatch):
    monkeypatch.setenv("NEUROSYM_NO_CACHE", "1")
    with pytest.raises(ValueError, match="ours"):
        run_command(Options, raising(ValueError("ours")), [])


def test_a_plugin_comes_first_and_options_are_those_of_the_command(monkeypatch, tmp_path):
    monkeypatch.setenv("NEUROSYM_NO_CACHE", "1")
    plugin = tmp_path / "mine.py"
    plugin.write_text("import builtins\nbuiltins.plugin_of_a_test = True\n")
    found = []
    with pytest.raises(SystemExit):
        run_command(Options, found.append, ["--plugin", str(plugin), "--samples", "3"])
    assert found == [Options(samples=3)]
    assert type(found[0]) is Options
    assert builtins.__dict__.pop("plugin_of_a_test")


def process(*arguments, cwd):
    # Of the environment, only what finds the packages: nothing that sets up jax.
    environment = {"PATH": os.environ["PATH"], "HOME": str(cwd), "PYTHONPATH": str(ROOT)}
    environment["JAX_PLATFORMS"] = "cpu"
    command = [sys.executable, *map(str, arguments)]
    return subprocess.run(
        command, cwd=cwd, env=environment, capture_output=True, text=True, timeout=120, check=False
    )


@pytest.mark.slow
def test_a_real_process(tmp_path):
    (tmp_path / "tracks.csv").write_text("0,1,2,3\n1,1,2,oops\n")
    done = process(ROOT / "evaluate.py", "--data", "tracks.csv", cwd=tmp_path)
    assert done.returncode == 2
    assert done.stdout == ""
    assert done.stderr == "error: tracks.csv: row 2: y is not a number: 'oops'\n"
    assert not list(tmp_path.glob("results/*"))


@pytest.mark.slow
def test_import_has_no_side_effects(tmp_path):
    """Nothing heavy is imported, jax is left as it is, no file appears."""
    script = """
import os, sys, jax
before = dict(jax.config.values), dict(os.environ)
import neurosym_jax
assert (dict(jax.config.values), dict(os.environ)) == before, "settings changed"
heavy = {"matplotlib", "orbax", "polars", "tyro", "torch", "tqdm", "optax"} & set(sys.modules)
assert not heavy, heavy
assert jax.config.jax_compilation_cache_dir is None
assert set(neurosym_jax.__all__) <= set(dir(neurosym_jax))
"""
    done = process("-c", script, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert list(tmp_path.iterdir()) == []
