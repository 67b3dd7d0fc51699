"""Bad input through the command line: one clear line, a status of 2, never a traceback."""

import builtins
import dataclasses
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


@pytest.fixture
def evaluate(tmp_path, monkeypatch, capsys):
    """Runs evaluate.py's command in this process; gives status and stderr's lines."""
    monkeypatch.setenv("NEUROSYM_NO_CACHE", "1")

    def command(*arguments):
        written = ["--json", str(tmp_path / "rows.json"), "--no-figures"]
        with pytest.raises(SystemExit) as caught:
            run_command(Options, run, [*written, *map(str, arguments)])
        assert not (tmp_path / "rows.json").exists()
        out, err = capsys.readouterr()
        assert out == ""
        return caught.value.code, err.splitlines()

    return command


def test_bad_rows(evaluate, tmp_path):
    path = tmp_path / "tracks.txt"
    path.write_text("0 1 2 3\n1 1 2 abc\n")
    message = f"error: {path}: row 2: y is not a number: 'abc'"
    assert evaluate("--data", path) == (2, [message])


def test_bad_places(evaluate, tmp_path):
    (tmp_path / "empty").mkdir()
    (tmp_path / "walks").mkdir()
    (tmp_path / "walks/walk.txt").write_text(GOOD)
    (tmp_path / "short.txt").write_text("0 1 2 3\n0 2 3 3\n")
    (tmp_path / "binary.txt").write_bytes(bytes(range(256)))
    (tmp_path / "corrupt.pt").write_bytes(b"PK\x03\x04" + bytes(range(256)))
    (tmp_path / "mine.json").write_text("{}")
    for arguments, reason in {
        ("--data", "absent"): "absent: no such file or folder",
        ("--data", tmp_path / "empty"): "no .txt, .csv, ",
        ("--data", tmp_path / "short.txt"): "too few frames: 1 where a window needs 16",
        ("--data", tmp_path / "binary.txt"): "not text",
        ("--data", tmp_path / "walks", "--dataset", "zara9"): "unknown dataset 'zara9'",
        ("--data", tmp_path / "walks", "--test-on", "run"): "run: no such file, nor a recording",
        ("--checkpoint", "absent.pt"): "absent.pt: no such checkpoint",
        ("--checkpoint", tmp_path / "corrupt.pt"): "corrupt.pt: ",
        ("--checkpoint", tmp_path / "walks"): "it has no config.json",
        ("--samples", "0"): "--samples must be at least 1, not 0",
        ("--seed", "-1"): "--seed must lie in",
    }.items():
        status, lines = evaluate(*arguments)
        assert status == 2
        assert len(lines) == 1, lines
        assert lines[0].startswith("error: ")
        assert reason in lines[0]


def test_contradicting_a_published_checkpoint(evaluate, shared):
    path = shared / "checkpoints/sgan-models/zara1_12_model.pt"
    data = ("--data", shared / "data/eth_ucy", "--checkpoint", path)
    for more, reason in {
        ("--pred-len", "8"): "has pred_len 12, but --pred-len 8 is asked for",
        ("--dataset", "eth"): "leaves zara1 out of its training",
    }.items():
        status, (line,) = evaluate(*data, *more)
        assert status == 2
        assert line.startswith(f"error: {path}: ")
        assert reason in line


def status_of(action):
    with pytest.raises(SystemExit) as caught:
        run_command(Options, action, [])
    return caught.value.code


def test_exit_status(monkeypatch, capsys):
    monkeypatch.setenv("NEUROSYM_NO_CACHE", "1")
    assert status_of(lambda options: None) == 0
    assert status_of(lambda options: [1]) == 0
    assert status_of(lambda options: 3) == 3

    def refuse(options):
        raise InputError("no")

    assert status_of(refuse) == 2
    assert capsys.readouterr().err == "error: no\n"

    def broken(options):
        raise ValueError("ours")

    with pytest.raises(ValueError, match="ours"):
        run_command(Options, broken, [])


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
    return subprocess.run(
        [sys.executable, *map(str, arguments)],
        cwd=cwd,
        env=environment,
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )


@pytest.mark.slow
def test_a_real_process(tmp_path):
    (tmp_path / "tracks.csv").write_text("0,1,2,3\n1,1,2,oops\n")
    done = process(ROOT / "evaluate.py", "--data", "tracks.csv", cwd=tmp_path)
    assert done.returncode == 2
    assert done.stdout == ""
    assert done.stderr == "error: tracks.csv: row 2: y is not a number: 'oops'\n"
    assert not (tmp_path / "results").exists()


@pytest.mark.slow
def test_import_has_no_side_effects(tmp_path):
    """Nothing heavy is imported, jax is left as it is, no file appears."""
    script = """
import os, sys, jax
before = dict(jax.config.values), dict(os.environ)
import neurosym_jax
assert (dict(jax.config.values), dict(os.environ)) == before, "settings changed"
heavy = {"matplotlib", "orbax", "tyro", "torch", "tqdm", "optax", "rosbags"} & set(sys.modules)
assert not heavy, heavy
assert jax.config.jax_compilation_cache_dir is None
assert set(neurosym_jax.__all__) <= set(dir(neurosym_jax))
"""
    done = process("-c", script, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("error", "status", "line"),
    [
        (KeyboardInterrupt(), 130, "interrupted"),
        (OSError(28, "No space left on device"), 2, "error: [Errno 28] No space left on device"),
    ],
)
def test_what_is_no_error_of_ours_ends_in_one_line(capsys, monkeypatch, error, status, line):
    monkeypatch.setenv("NEUROSYM_NO_CACHE", "1")

    @dataclasses.dataclass(frozen=True)
    class Options:
        """None."""

    def fail(options):
        raise error

    with pytest.raises(SystemExit) as caught:
        run_command(Options, fail, [])
    assert caught.value.code == status
    assert capsys.readouterr().err == f"{line}\n"
