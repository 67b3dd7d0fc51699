"""Run a command with recorders in place of its inner functions, to see what an option changes."""

import contextlib
import dataclasses
import hashlib
import importlib
import itertools
import os
import re
import shlex
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np
import pytest

from neurosym_jax.__main__ import commands, main
from neurosym_jax.commands._options import every_option
from neurosym_jax.training.sweep import SweepRun

Case = str | Sequence[str]
"""What is added to the base of a command; or two command lines, without the option and with it, and
perhaps the error of the second."""


NOT_DONE = {"options", "seconds"}
"""Fields that hold the options themselves, and times."""
DONE: dict[tuple[str, str], tuple[Any, str]] = {}
"""What a command line does, by command and line."""
FILE = "# neurosym-jax"
"""The first words of a file of options."""


KINDS = ("person", "robot")
TABLE = "time=t id=who x=px y=py"
READ = {
    "--format": ("walk.txt", "--format trajnet", "neither a track nor a scene"),
    "--columns": ("tables/odd.csv", f"--columns {TABLE}"),
    "--unit": ("walk.txt", "--unit 2"),
    "--time-unit": ("tables/ms.csv", "--time-unit ms"),
    "--keep": ("tables/kinds.csv", "--keep robot"),
    "--fps": ("walk.txt", "--fps 30"),
    "--eth-stride": ("tables/biwi_eth.txt", "--eth-stride 12"),
    "--max-gap": ("gap.txt", "--max-gap 9"),
    "--allow": ("tables/fast.txt", "--allow fast"),
    "--homography": ("walk.txt", "--homography {d}/a.h --allow slow"),
    "--flip-y": ("walk.txt", "--flip-y"),
    "--missing": ("tables/lost.txt", "--missing=-1000"),
}
"""Options of reading: a file, and what is said of it."""


def _lost(frame: int, person: int, x: float, y: float) -> tuple[float, ...]:
    """A row, of which every second position of person 2 is not known."""
    if person == 2 and frame % 20 == 0:
        return frame, person, -1000, -1000
    return frame, person, x, y


def write_data(folder: Path) -> Path:
    """Folders `a` and `b` of people who walk about, one of them alone at first."""
    for seed, name in enumerate("ab"):
        rng = np.random.default_rng(seed)
        moves = rng.normal(0.3, 0.1, (5, 1, 2)) + rng.normal(0, 0.05, (5, 100, 2))
        track = rng.uniform(-3, 3, (5, 1, 2)) + moves.cumsum(1)
        rows = [
            (t, i, *track[i, t])
            for t, i in itertools.product(range(100), range(5))
            if t > 25 or not i
        ]

        frames = [(10 * t, i, x, y) for t, i, x, y in rows]
        seconds = [(0.4 * t, i, x, y) for t, i, x, y in rows]
        files = {
            "walk.txt": ("", frames),
            "gap.txt": (
                "",
                [(f, i, -y, x) for f, i, x, y in frames if i != 1 or not 400 < f < 460],
            ),
            "tables/biwi_eth.txt": ("", frames),
            "tables/lost.txt": ("", [_lost(*row) for row in frames]),
            "tables/fast.txt": ("", [(f, i, 9 * x, 9 * y) for f, i, x, y in frames]),
            "tables/odd.csv": ("t,who,px,py", seconds),
            "tables/ms.csv": ("time,id,x,y", [(1000 * t, *row) for t, *row in seconds]),
            "tables/kinds.csv": (
                "time,id,x,y,class",
                [(*r, KINDS[r[1] > 2]) for r in seconds],
            ),
        }
        for file, (head, table) in files.items():
            (folder / name / file).parent.mkdir(parents=True, exist_ok=True)
            lines = [",".join(map(str, row)) for row in table]
            (folder / name / file).write_text(
                "\n".join([head, *lines] if head else lines)
            )
    return folder


def options_of(command: str) -> list[str]:
    """Names of the options, and in capitals of what is positional."""
    module = importlib.import_module(commands()[command])
    options = getattr(module, "Options", module.run)
    return [flag.split()[0] for _, flag, *_ in every_option(options)]


def plain(value: Any) -> Any:
    """What can be compared: arrays as digests, functions and other objects by name."""
    if isinstance(value, SweepRun):
        return str(value.folder), value.options.splitlines()
    if isinstance(value, str) and value.startswith(FILE):
        return FILE
    if isinstance(value, np.ndarray):
        return hashlib.sha256(value.tobytes()).hexdigest()
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        names = (field.name for field in dataclasses.fields(value))
        value = {name: getattr(value, name) for name in names if name not in NOT_DONE}
    if isinstance(value, dict):
        return {str(name): plain(item) for name, item in value.items()}
    if isinstance(value, list | tuple | set | Iterator):
        return [plain(item) for item in value]
    if isinstance(value, str | int | float | bytes | None | Path):
        return value
    return getattr(value, "__qualname__", type(value).__qualname__)


def done(argv: list[str], inner: dict[str, Any], cwd: Path, capsys) -> tuple[Any, str]:
    """What `neurosym` does in a new folder, and its error.

    `inner` names the functions that are recorded and not called, each with what they
    return.
    """
    log = []

    def recorder(name: str, result: Any):
        def record(*args, **kwargs):
            log.append([name, plain(args), plain(kwargs)])
            return result() if callable(result) else result

        return record

    cwd.mkdir()
    capsys.readouterr()
    with contextlib.ExitStack() as stack:
        stack.enter_context(contextlib.chdir(cwd))
        stack.enter_context(mock.patch.dict(os.environ, NEUROSYM_NO_CACHE="1"))
        for name, result in inner.items():
            stack.enter_context(mock.patch(name, recorder(name, result)))
        with pytest.raises(SystemExit) as ended:
            main(argv)
    mocks = {id(item): item for item in inner.values() if isinstance(item, mock.Mock)}
    for item in mocks.values():
        log.append(re.sub(" at 0x[0-9a-f]+", "", str(item.mock_calls)))
        item.reset_mock()
    out, err = capsys.readouterr()
    files = sorted(str(path.relative_to(cwd)) for path in cwd.rglob("*"))
    status = ended.value.code or 0
    return (status, log, files, out), err if status == 2 else ""


def _without(base: str, case: str) -> str:
    """The line without the option that `case` gives, and without its values."""
    option = case.split()[0]
    parts = re.split("(?:^| )(?=--)", base)
    return " ".join(part for part in parts if part.split()[:1] != [option])


def assert_it_matters(
    command: str,
    base: str,
    case: Case,
    inner: dict[str, Any],
    data: Path,
    folder: Path,
    capsys,
) -> None:
    """That an option changes what is done, which nothing changes by itself, and is no error."""
    if isinstance(case, str):
        case = (base, f"{_without(base, case)} {case}")
    first, second, *refusal = case

    def run(line: str, at: str) -> tuple[Any, str]:
        argv = [command, *shlex.split(line.replace("{d}", str(data)))]
        return done(argv, inner, folder / at, capsys)

    key = (command, first)
    if key not in DONE:
        DONE[key] = run(first, "without")
        assert run(first, "again") == DONE[key]
    with_it, error = run(second, "with")
    assert refusal[0] in error if refusal else not error, error
    assert with_it != DONE[key][0], f"{second}: the option changes nothing"
