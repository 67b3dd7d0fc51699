"""Tables as text: in Markdown, and in aligned columns for a terminal."""

from collections.abc import Iterable, Sequence

__all__ = ["aligned_table", "markdown_table"]


def markdown_table(head: Sequence[str], rows: Iterable[Sequence[str]], *, right: int = 0) -> str:
    """Lines of a table; `right` of its last columns are aligned to the right.

    A `|` or a line's end in a cell stays within the cell.
    """
    rule = ["---"] * (len(head) - right) + ["---:"] * right
    lines = [_line(head), f"|{'|'.join(rule)}|", *map(_line, rows)]
    return "\n".join(lines)


def aligned_table(rows: Sequence[Sequence[str]]) -> str:
    """Rows of cells, the head among them, as lines whose columns stand below each other."""
    widths = [max(map(len, column)) for column in zip(*rows)]
    return "\n".join("  ".join(map(str.ljust, row, widths)).rstrip() for row in rows)


def _line(cells: Sequence[str]) -> str:
    texts = (" ".join(cell.split()).replace("|", r"\|") for cell in cells)
    return f"|{'|'.join(f' {text} ' if text else ' ' for text in texts)}|"
