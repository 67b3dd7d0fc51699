"""Plant one mistake at a time, and see whether the tests of its package fail.

python -m studies.mutants --seed 0 --count 40 --out mutants.jsonl

The seed draws mistakes from the lines of five packages: another sign, comparison, bound or
constant, swapped arguments, an omitted `not`. `tests/PACKAGE`, but for slow ones, the tests of
configurations and of the architecture, and the stored forecasts run in a copy of the last commit
until the first failure, or for five times as long as without a mistake. The file has a line for
each, so a study can be resumed, or made longer. A person who finds that a survivor changes nothing
writes the reason into its line as `"equivalent"`; the table counts these, and the other survivors
are listed below it.
"""

import argparse
import ast
import copy
import json
import os
import random
import resource
import subprocess
import sys
import tempfile
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
    planted_before = {(mistake["file"], mistake["at"], mistake["after"]) for mistake in planted}
    drawn = [mistake for mistake in _mistakes() if mistake[0] in options.packages]
    random.Random(options.seed).shuffle(drawn)
    with tempfile.TemporaryDirectory() as folder:
        (place := Path(folder, "copy")).mkdir()
        subprocess.run(f"git archive HEAD | tar x -C {place}", shell=True, cwd=ROOT, check=True)
        usual: dict[str, int] = {}
        for package, file, at, before, after, text in drawn[: options.count]:
            if (file, at, after) in planted_before:
                continue
            if package not in usual:
                failed, usual[package] = _tests_fail(place, package, 3600)
                assert not failed, f"tests/{package} fail without a mistake"
            original = (place / file).read_text()
            (place / file).write_text(text)
            limit = 60 + 5 * usual[package]
            failed, seconds = _tests_fail(place, package, limit, Path(file).stem)
            (place / file).write_text(original)
            facts = {"file": file, "at": at, "before": before, "after": after}
            planted.append({"package": package, **facts, "killed": failed, "seconds": seconds})
            with options.out.open("a") as log:
                log.write(json.dumps(planted[-1]) + "\n")
            print("killed  " if failed else "SURVIVED", f"{file}:{at}: {before} -> {after}")
    rows = []
    for package in PACKAGES:
        killed = [mistake["killed"] for mistake in planted if mistake["package"] == package]
        argued = [
            mistake
            for mistake in planted
            if mistake["package"] == package and "equivalent" in mistake
        ]
        if killed:
            rows.append([package, *map(str, (len(killed), sum(killed), len(argued)))])
    print(markdown_table(["package", "planted", "noticed", "equivalent"], rows, right=3))
    for mistake in planted:
        if not mistake["killed"]:
            why = mistake.get("equivalent", "no test notices it")
            print("{file}:{at}: {before} -> {after}: ".format(**mistake) + why)


def _mistakes() -> Iterator[tuple[str, str, str, str, str, str]]:
    """Package, file, line and column, what stands there, what shall, and the file with it."""
    for package in PACKAGES:
        for path in sorted((ROOT / "neurosym_jax" / package).glob("*.py")):
            text = path.read_text()
            for node, mistake in mutations(ast.parse(text)):
                before, after = ast.unparse(node), ast.unparse(mistake)
                at, mutated = (
                    f"{node.lineno}:{node.col_offset}",
                    _replaced(text, node, f"({after})"),
                )
                yield package, str(path.relative_to(ROOT)), at, before, after, mutated


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
    vars(copied := copy.copy(node)).update(fields)
    return copied


def _replaced(text: str, node: Any, by: str) -> str:
    """`text` with the source of `node` replaced; columns count bytes."""
    source = text.encode()
    lines = [0, *map(len, source.splitlines(keepends=True))]
    start = sum(lines[: node.lineno]) + node.col_offset
    end = sum(lines[: node.end_lineno]) + node.end_col_offset
    return (source[:start] + by.encode() + source[end:]).decode()


def _tests_fail(place: Path, package: str, limit: int, first: str = "") -> tuple[bool, int]:
    """Whether the tests of `package` fail or take more than `limit` seconds; and those taken.

    Seconds are the processor's, for others may have it, too. The test file `first` begins.
    """
    caches = place.parent / "caches"
    environment = {**os.environ, "PYTHONPATH": str(place), "PYTHONDONTWRITEBYTECODE": "1"}
    # As in a worker of pytest-xdist, programs are compiled once for all runs.
    environment |= {"PYTEST_XDIST_WORKER": "mutants", "XDG_CACHE_HOME": str(caches)}
    environment |= {"JAX_COMPILATION_CACHE_DIR": f"{caches}/xla", "NEUROSYM_DATA": f"{caches}/data"}
    shared = os.environ.get("NEUROSYM_SHARED", ROOT.parent / "shared")  # As for the suite here.
    environment["NEUROSYM_SHARED"] = str(shared)
    own = f"tests/{package}/test_{first}.py"
    tests = [own] * (place / own).exists() + [f"tests/{package}", "tests/test_config.py"]
    tests += ["tests/test_architecture.py"]
    tests += ["tests/test_golden.py"] * (package in ("symbolic", "models", "forecasting"))
    command = [sys.executable, "-m", "pytest", "-n", "0", "-x", "-q", "-p", "no:cacheprovider"]
    command += ["-m", "not slow and not exhaustive", *tests]
    limited = ["bash", "-c", f'ulimit -t {limit}; exec timeout {10 * limit} "$@"', "", *command]
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    done = subprocess.run(limited, cwd=place, env=environment, capture_output=True)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    seconds = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return done.returncode != 0, round(seconds)


if __name__ == "__main__":
    main(sys.argv[1:])
