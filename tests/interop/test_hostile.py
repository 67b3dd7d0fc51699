"""Archives that two readers read differently, through all that opens a checkpoint.

Each holds a checkpoint and a program that makes a file. Which of them a reader takes
depends on its rules: of names, of case, of where an archive begins.
"""

import contextlib
import io
import itertools
import pickle
import warnings
import zipfile

import numpy as np
import pytest

import neurosym_jax as nj
from neurosym_jax.__main__ import main
from neurosym_jax.errors import InputError
from neurosym_jax.interop import hub
from neurosym_jax.interop.checkpoint import load_torch_checkpoint
from neurosym_jax.interop.pickles import read_torch_file
from neurosym_robot.online.predictor import load_models
from tests.interop.test_pickles import Hostile, as_legacy
from tests.repository import ROOT, SMALL

MODULE = f"{ROOT / 'tests/interop/sgan_torch.py'}:TrajectoryGenerator"
PROGRAM = "archive/data.pkl"


def entries():
    """Name and content of the entries of a checkpoint as torch wrote it."""
    with zipfile.ZipFile(SMALL) as archive:
        root = archive.namelist()[0].split("/")[0]
        return {
            name.replace(root, "archive", 1): archive.read(name)
            for name in archive.namelist()
        }


def packed(*parts):
    """An archive of (name, content)."""
    file = io.BytesIO()
    with warnings.catch_warnings(), zipfile.ZipFile(file, "w") as archive:
        warnings.filterwarnings("ignore", message="Duplicate name")
        for name, content in parts:
            archive.writestr(name, content)
    return file.getvalue()


def with_other_name(archive, name, other, where):
    """The archive whose directory and whose entry disagree about a name."""
    first = archive.index(name)
    at = first if where == "entry" else archive.rindex(name)
    return archive[:at] + other + archive[at + len(name) :]


def crafted(trace):
    """Twelve files and more by what is wrong with them."""
    program = pickle.dumps(
        {"g_state": {}, "args": {}, "x": Hostile(f"touch {trace}")}, 2
    )
    good = entries()
    plain = packed(*good.items())
    evil = packed(*(good | {PROGRAM: program}).items())
    upper = "archive/data.PKL", program
    lines = [*good.items()]
    return {
        "the program itself": evil,
        "legacy": as_legacy(evil),
        "a program in capitals, last": packed(*lines, upper),
        "a program in capitals, first": packed(upper, *lines),
        "a folder in capitals": packed(("ARCHIVE/data.pkl", program), *lines),
        "one name twice, last": packed(*lines, (PROGRAM, program)),
        "one name twice, first": packed((PROGRAM, program), *lines),
        "two folders": packed(("another/data.pkl", program), *lines),
        "a folder in a folder": packed(*lines, ("archive/archive/data.pkl", program)),
        "backslashes": packed(*lines, ("archive\\data.pkl", program)),
        "an end of text in the name": packed(
            *lines, ("archive/data.pkl_x", program)
        ).replace(b"data.pkl_x", b"data.pkl\0x"),
        "archives one after the other": evil + plain,
        "the other order": plain + evil,
        "a program in front": program + plain,
        "a program behind": plain + program,
        "another name in the directory": with_other_name(
            packed(*lines, ("archive/data.pkm", program)),
            b"data.pkm",
            b"data.pkl",
            "directory",
        ),
        "another name at the entry": with_other_name(
            packed(*lines, ("archive/data.pkm", program)),
            b"data.pkm",
            b"data.pkl",
            "entry",
        ),
        "constants of a script": packed(*lines, ("archive/constants.pkl", program)),
        "a legacy head": as_legacy(plain)[:300] + evil,
        "no archive": program,
    }


NAMES = list(crafted("nowhere"))
BENIGN = ("a program behind", "constants of a script")
"""Read as the checkpoint that they hold, by us; what is beside it is not opened."""
FUNCTIONS = {
    "read_torch_file": read_torch_file,
    "load_torch_checkpoint": load_torch_checkpoint,
    "load_model": nj.load_model,
    "from_pretrained": hub.from_pretrained,
    "load_models": lambda path: load_models([path]),
    "predict": lambda path: nj.predict(nj.load_model(path), np.zeros((2, 8, 2))),
    "evaluate": lambda path: nj.evaluate([path], path.with_name("walk.csv")),
}
"""Each opens a checkpoint."""


def make(tmp_path, name):
    trace = tmp_path / "trace"
    path = tmp_path / "a.pt"
    path.write_bytes(crafted(trace)[name])
    walk = [
        f"{frame},{person},{frame / 2},{person}"
        for frame, person in itertools.product(range(40), range(3))
    ]
    path.with_name("walk.csv").write_text("\n".join(["frame,id,x,y", *walk]))
    return path, trace


@pytest.mark.parametrize("name", NAMES)
def test_no_function_runs_what_is_in_an_archive(tmp_path, name):
    path, trace = make(tmp_path, name)
    for function in FUNCTIONS.values():
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            with contextlib.suppress(InputError):
                function(path)
        assert not trace.exists()


@pytest.mark.parametrize("name", [name for name in NAMES if name not in BENIGN])
def test_what_readers_would_read_differently_is_refused(tmp_path, name):
    path, _ = make(tmp_path, name)
    with pytest.raises(InputError, match=r"a\.pt: "):
        read_torch_file(path)


COMMANDS = [
    ["convert", "{}", "{}.folder", "--generator-only"],
    ["convert", "{}", "{}.folder", "--ignore-arg", "x"],
    ["export", "{}", "{}.bin"],
    ["parity", "--torch-module", MODULE, "--checkpoint", "{}"],
    ["symbols", "--model", "{}", "--out", "{}.figures"],
    ["evaluate", "--model", "{}", "--json", "{}.json", "--no-figures"],
    ["train", "--init", "{}", "--steps", "1", "--out", "{}.run", "--quiet"],
    ["replay", "walk.csv", "--model", "{}"],
]


@pytest.mark.parametrize("command", COMMANDS, ids=lambda words: " ".join(words[:3]))
def test_no_command_runs_what_is_in_an_archive(tmp_path, monkeypatch, command, capsys):
    for number, name in enumerate(NAMES):
        if name in BENIGN:
            continue  # The functions read it, and parity below.
        folder = tmp_path / str(number)
        folder.mkdir()
        monkeypatch.chdir(folder)
        path, trace = make(folder, name)
        with pytest.raises(SystemExit) as ended:
            main([word.replace("{}", str(path)) for word in command])
        assert ended.value.code == 2
        assert "a.pt: " in capsys.readouterr().err
        assert not trace.exists(), name


@pytest.mark.slow
@pytest.mark.parametrize("name", BENIGN)
def test_parity_runs_nothing_beside_a_checkpoint(tmp_path, monkeypatch, name):
    monkeypatch.chdir(tmp_path)
    path, trace = make(tmp_path, name)
    (command,) = (words for words in COMMANDS if words[0] == "parity")
    with pytest.raises(SystemExit) as ended:
        main([word.replace("{}", str(path)) for word in command])
    assert ended.value.code in (None, 0, 2)
    assert not trace.exists()


def test_torch_itself_would_run_some_of_them(tmp_path, torch):
    """Else the files above would show nothing."""
    executed = []
    for number, name in enumerate(NAMES):
        folder = tmp_path / str(number)
        folder.mkdir()
        path, trace = make(folder, name)
        with contextlib.suppress(Exception):  # Whatever torch says of it.
            torch.load(path, map_location="cpu", weights_only=False)
        executed += [name] * trace.exists()
    print(executed)
    assert {"a program in capitals, first", "the program itself"} <= set(executed)


def test_an_archive_of_torch_passes(tmp_path):
    path = tmp_path / "a.pt"
    path.write_bytes(packed(*entries().items()))
    load_torch_checkpoint(path)
