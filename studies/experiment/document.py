"""A report of text, tables and figures as Markdown."""

import re
from collections.abc import Sequence
from pathlib import Path

__all__ = ["Document"]


class Document:
    """Blocks in order, for a file in `folder`."""

    def __init__(self, title: str, folder: Path):
        """With a title alone."""
        self._folder, self._blocks = folder, [f"# {title}"]

    def heading(self, text: str) -> None:
        """A section begins."""
        self._blocks.append(f"## {text}")

    def text(self, text: str) -> None:
        """A paragraph."""
        self._blocks.append(" ".join(text.split()))

    def code(self, text: str) -> None:
        """Lines as they are typed."""
        self._blocks.append("\n".join(f"    {line}" for line in text.splitlines()))

    def table(self, caption: str, head: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
        """A table; columns whose cells are numbers or empty are set to the right."""
        rule = ["---:" if all(map(_is_number, cells)) else "---" for cells in zip(*rows)]
        self._blocks.append(f"**{caption}**")
        self._blocks.append("\n".join(f"| {' | '.join(row)} |" for row in [head, rule, *rows]))

    def figure(self, path: Path, caption: str) -> None:
        """An image file in, or below, the folder."""
        place = path.relative_to(self._folder).as_posix()
        self._blocks += [f"![{caption}]({place})", caption]

    def markdown(self) -> str:
        """All of it."""
        return "\n\n".join(self._blocks) + "\n"


def _is_number(cell: str) -> bool:
    return re.fullmatch(r"[-–\d.,/ %]*", cell) is not None
