"""The size of the code by package, at several commits: `python -m studies.sizes a5ca0f7 HEAD`.

Prints lines of Python, files and statements without docstrings: the table of
docs/architecture.md.
"""

import ast
import collections
import io
import subprocess
import sys
import tarfile
from collections.abc import Iterator
from typing import Any

from neurosym_jax.evaluation.markdown import markdown_table

__all__ = ["main"]

PACKAGES = ("neurosym_jax", "neurosym_robot")
FOLDERS = (*PACKAGES, "tests", "studies", "benchmarks", "examples")


def main(revisions: list[str]) -> None:
    """Print the table of these commits."""
    sizes = [_sizes(revision) for revision in revisions]
    names = sorted(
        {name for size in sizes for name in size},
        key=lambda name: (FOLDERS.index(name.split("/")[0]), name),
    )
    head = ["", *(f"{revision}: lines, files, statements" for revision in revisions)]
    rows = [
        [
            name,
            *(
                f"{size[name][0]:,}, {size[name][1]}, {size[name][2]:,}"
                for size in sizes
            ),
        ]
        for name in names
    ]
    print(markdown_table(head, rows, right=len(revisions)))


def _sizes(revision: str) -> dict[str, list[int]]:
    """By package: lines, files, statements."""
    totals: dict[str, list[int]] = collections.defaultdict(lambda: [0, 0, 0])
    for path, text in _files(revision):
        parts = path.split("/")
        names = [parts[0]]
        if parts[0] in PACKAGES and len(parts) > 2:
            names.append("/".join(parts[:2]))
        statements = sum(
            isinstance(node, ast.stmt)
            and not (
                isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)
            )
            for node in ast.walk(ast.parse(text))
        )
        for name in names:
            for at, count in enumerate((text.count("\n"), 1, statements)):
                totals[name][at] += count
    return totals


def _files(revision: str) -> Iterator[tuple[str, str]]:
    """(path, text) of the Python files of a commit."""
    archive = subprocess.run(
        ["git", "archive", revision], capture_output=True, check=True
    ).stdout
    with tarfile.open(fileobj=io.BytesIO(archive)) as files:
        for member in files:
            if member.name.startswith(FOLDERS) and member.name.endswith(".py"):
                content: Any = files.extractfile(member)
                yield member.name, content.read().decode()


if __name__ == "__main__":
    main(sys.argv[1:] or ["HEAD"])
