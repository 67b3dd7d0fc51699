"""Plant one mistake at a time, and see whether the tests of its package fail.

python -m studies.mutants --seed 0 --count 40 --out mutants.jsonl

The seed draws mistakes from the lines of five packages: another sign, comparison, bound or
constant, swapped arguments, an omitted `not`. `tests/PACKAGE`, but for slow ones, and the stored
forecasts run in a copy of the last commit until the first failure, or for five times as long as
without a mistake. The file has a line for each, so a study can be resumed, or made longer.
"""

import argparse
import ast
import copy
import json
import os
import random
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from neurosym_jax.evaluation.markdown import markdown_table

__all__ = ["main", "mutations"]

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = ("symbolic", "models", "data", "evaluation", "forecasting")
SIGNS = {ast.Add: ast.Sub, ast.Sub: ast.Add, ast.Mult: ast.Div, ast.Div: ast.Mult}
BOUNDS = {ast.Lt: ast.LtE, ast.LtE: ast.Lt, ast.Gt: ast.GtE, ast.GtE: ast.Gt}
BOUNDS |= {ast.Eq: ast.NotEq, ast.NotEq: ast.Eq, ast.Is: ast.IsNot, ast.IsNot: ast.Is}
LOGIC = {ast.And: ast.Or, ast.Or: ast.And, ast.BitAnd: ast.BitOr, ast.BitOr: ast.BitAnd}


def main(arguments: list[str]) -> None:
    """Plant the mistakes that FILE lacks, and print the table of all."""
    parser = argparse.ArgumentParser(prog="python -m studies.mutants")
    for option, default in (("seed", 0), ("count", 40), ("out", Path("mutants.jsonl"))):
        parser.add_argument(f"--{option}", type=type(default), default=default)
    parser.add_argument("--packages", nargs="+", choices=PACKAGES, default=PACKAGES)
    options = parser.parse_args(arguments)
    options.out.touch()
    planted = [json.loads(line) for line in options.out.read_text().splitlines()]
    known = {(each["file"], each["at"], each["after"]) for each in planted}
    drawn = [each for each in _mistakes() if each[0] in options.packages]
    random.Random(options.seed).shuffle(drawn)
    with tempfile.TemporaryDirectory() as folder:
        (place := Path(folder, "copy")).mkdir()
        subprocess.run(f"git archive HEAD | tar x -C {place}", shell=True, cwd=ROOT, check=True)
        usual: dict[str, float] = {}
        for package, file, at, before, after, text in drawn[: options.count]:
            if (file, at, after) in known:
                continue
            if package not in usual:
                failed, usual[package] = _tests_fail(place, package, None)
                assert not failed, f"tests/{package} fail without a mistake"
            whole = (place / file).read_text()
            (place / file).write_text(text)
            failed, seconds = _tests_fail(place, package, 60 + 5 * usual[package])
            (place / file).write_text(whole)
            facts = {"file": file, "at": at, "before": before, "after": after}
            planted.append({"package": package, **facts, "killed": failed, "seconds": seconds})
            with options.out.open("a") as kept:
                kept.write(json.dumps(planted[-1]) + "\n")
            print("killed  " if failed else "SURVIVED", f"{file}:{at}: {before} -> {after}")
    rows = []
    for package in PACKAGES:
        found = [each["killed"] for each in planted if each["package"] == package]
        rows.append([package, str(len(found)), str(sum(found))])
    print(markdown_table(["package", "planted", "noticed"], rows, right=2))


def _mistakes() -> Iterator[tuple[str, str, str, str, str, str]]:
    """Package, file, line and column, what stands there, what shall, and the file with it."""
    for package in PACKAGES:
        for path in sorted((ROOT / "neurosym_jax" / package).glob("*.py")):
            text = path.read_text()
            for node, mistake in mutations(ast.parse(text)):
                before, after = ast.unparse(node), ast.unparse(mistake)
                at, whole = f"{node.lineno}:{node.col_offset}", _replaced(text, node, f"({after})")
                yield package, str(path.relative_to(ROOT)), at, before, after, whole


def mutations(tree: ast.AST) -> Iterator[tuple[Any, ast.expr]]:
    """(node, another node in its place) for every mistake that can be planted into `tree`."""
    for node in ast.iter_child_nodes(tree):
        if isinstance(node, ast.Raise | ast.JoinedStr | ast.ImportFrom):
            continue  # Messages are not numbers.
        yield from ((node, mistake) for mistake in _mistaken(node))
        inner: Any = node
        if isinstance(node, ast.FunctionDef):  # Annotations have no effect.
            inner = ast.Module([*node.args.defaults, *filter(None, node.args.kw_defaults)], [])
            inner.body += node.body
        elif isinstance(node, ast.AnnAssign):
            inner = ast.Module([node.value] if node.value else [], [])
        yield from mutations(inner)


def _mistaken(node: Any) -> Iterator[Any]:
    match node:
        case ast.BinOp() | ast.BoolOp() if other := (SIGNS | LOGIC).get(type(node.op)):
            yield _changed(node, op=other())
        case ast.Compare(ops=[op]) if other := BOUNDS.get(type(op)):
            yield _changed(node, ops=[other()])
        case ast.UnaryOp(op=ast.USub() | ast.Not() | ast.Invert()):
            yield node.operand
        case ast.Constant(value=bool(value)):
            yield _changed(node, value=not value)
        case ast.Constant(value=int(value)):
            yield _changed(node, value=value + 1)
        case ast.Constant(value=float(value)):
            yield _changed(node, value=2 * value + 0.1)
        case ast.Call(args=[ast.Name() as one, ast.Name() as other, *rest]):
            yield _changed(node, args=[other, one, *rest])


def _changed(node: Any, **fields: Any) -> Any:
    vars(found := copy.copy(node)).update(fields)
    return found


def _replaced(text: str, node: Any, by: str) -> str:
    """`text` with the source of `node` replaced; columns count bytes."""
    whole = text.encode()
    lines = [0, *map(len, whole.splitlines(keepends=True))]
    start = sum(lines[: node.lineno]) + node.col_offset
    end = sum(lines[: node.end_lineno]) + node.end_col_offset
    return (whole[:start] + by.encode() + whole[end:]).decode()


def _tests_fail(place: Path, package: str, limit: float | None) -> tuple[bool, float]:
    """Whether the tests of `package` fail, or take longer than `limit`; and the seconds taken."""
    caches = place.parent / "caches"
    environment = {**os.environ, "PYTHONPATH": str(place), "PYTHONDONTWRITEBYTECODE": "1"}
    # As in a worker of pytest-xdist, programs are compiled once for all runs.
    environment |= {"PYTEST_XDIST_WORKER": "mutants", "XDG_CACHE_HOME": str(caches)}
    environment |= {"JAX_COMPILATION_CACHE_DIR": f"{caches}/xla", "NEUROSYM_DATA": f"{caches}/data"}
    stored = ["tests/test_golden.py"] if package in ("symbolic", "models", "forecasting") else []
    command = [sys.executable, "-m", "pytest", "-n", "0", "-x", "-q", "-p", "no:cacheprovider"]
    command += ["-m", "not slow and not exhaustive", *stored, f"tests/{package}"]
    since, how = time.perf_counter(), {"cwd": place, "env": environment, "capture_output": True}
    try:
        failed = subprocess.run(command, timeout=limit, **how).returncode != 0
    except subprocess.TimeoutExpired:
        failed = True
    return failed, round(time.perf_counter() - since, 1)


if __name__ == "__main__":
    main(sys.argv[1:])
