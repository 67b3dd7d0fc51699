"""Tables as text, in Markdown and in aligned columns for a terminal; and foreign names in them."""

from collections.abc import Iterable, Sequence

from neurosym_jax.errors import printable

__all__ = ["aligned_table", "latex_text", "markdown_table", "markdown_text"]

LATEX = {**{sign: f"\\{sign}" for sign in "&%$#_{}"}, "\\": r"\textbackslash{}"}
LATEX |= {"~": r"\textasciitilde{}", "^": r"\textasciicircum{}", "±": r"$\pm$"}
MARKDOWN = {sign: f"\\{sign}" for sign in "\\`*[]"} | {
    "<": "&lt;",
    ">": "&gt;",
    "&": "&amp;",
}


def latex_text(text: str) -> str:
    """Foreign text that LaTeX prints as it is."""
    return "".join(LATEX.get(letter, letter) for letter in printable(text))


def markdown_text(text: str) -> str:
    """Foreign text that Markdown shows as it is; `markdown_table` escapes a `|`."""
    return "".join(MARKDOWN.get(letter, letter) for letter in printable(text))


def markdown_table(
    head: Sequence[str], rows: Iterable[Sequence[str]], *, right: int = 0
) -> str:
    """Lines of a table; `right` of its last columns are aligned to the right.

    A `|` or a line's end in a cell stays within the cell.
    """
    rule = ["---"] * (len(head) - right) + ["---:"] * right
    lines = [_line(head), f"|{'|'.join(rule)}|", *map(_line, rows)]
    return "\n".join(lines)


def aligned_table(rows: Sequence[Sequence[str]]) -> str:
    """Rows of cells, the head among them, as lines whose columns stand below each other.

    Characters that steer a terminal are escaped.
    """
    rows = [[printable(cell) for cell in row] for row in rows]
    widths = [max(map(len, column)) for column in zip(*rows)]
    return "\n".join("  ".join(map(str.ljust, row, widths)).rstrip() for row in rows)


def _line(cells: Sequence[str]) -> str:
    texts = (" ".join(cell.split()).replace("|", r"\|") for cell in cells)
    return f"|{'|'.join(f' {text} ' if text else ' ' for text in texts)}|"
