"""The size of the code by room, at several commits: `python -m studies.house a5ca0f7 HEAD`.

Prints lines of Python, files and statements without docstrings: the table of docs/architecture.md.
"""

import ast
import io
import subprocess
import sys
import tarfile
from collections.abc import Iterator

from neurosym_jax.evaluation.markdown import markdown_table

__all__ = ["main"]

PACKAGES = ("neurosym_jax", "neurosym_robot")
BESIDE = ("tests", "studies", "benchmarks", "examples")


def main(revisions: list[str]) -> None:
    """Print the table of these commits."""
    sizes = [_sizes(revision) for revision in revisions]
    rooms = sorted({room for of in sizes for room in of}, key=_order)
    head = ["", *(f"{revision}: lines, files, statements" for revision in revisions)]
    rows = [
        [room, *(f"{of[room][0]:,}, {of[room][1]}, {of[room][2]:,}" for of in sizes)]
        for room in rooms
    ]
    print(markdown_table(head, rows, right=len(revisions)))


def _sizes(revision: str) -> "_Sizes":
    """By room: lines, files, statements."""
    found: dict[str, list[int]] = {}
    for path, text in _files(revision):
        parts = path.split("/")
        rooms = [parts[0]]
        if parts[0] in PACKAGES and len(parts) > 2:
            rooms.append("/".join(parts[:2]))
        nodes = list(ast.walk(ast.parse(text)))
        statements = sum(
            isinstance(node, ast.stmt)
            and not (isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant))
            for node in nodes
        )
        for room in rooms:
            of = found.setdefault(room, [0, 0, 0])
            for at, count in enumerate((text.count("\n"), 1, statements)):
                of[at] += count
    return _Sizes(found)


class _Sizes(dict[str, list[int]]):
    def __missing__(self, room: str) -> list[int]:
        return [0, 0, 0]


def _files(revision: str) -> Iterator[tuple[str, str]]:
    """(path, text) of the Python files of a commit."""
    paths = [*PACKAGES, *BESIDE]
    names = subprocess.run(
        ["git", "ls-tree", "--name-only", revision], capture_output=True, text=True, check=True
    ).stdout.split()
    command = ["git", "archive", revision, *(path for path in paths if path in names)]
    archive = subprocess.run(command, capture_output=True, check=True).stdout
    with tarfile.open(fileobj=io.BytesIO(archive)) as files:
        for member in files:
            if member.isfile() and member.name.endswith(".py"):
                content = files.extractfile(member)
                assert content is not None
                yield member.name, content.read().decode()


def _order(room: str) -> tuple[int, str]:
    top = room.split("/")[0]
    return [*PACKAGES, *BESIDE].index(top), room


if __name__ == "__main__":
    main(sys.argv[1:] or ["HEAD"])
