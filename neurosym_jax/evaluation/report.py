"""An evaluation's rows as a table for people and as JSON for programs."""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from neurosym_jax.errors import InputError
from neurosym_jax.evaluation.summary import Line, lines_of, means_of
from neurosym_jax.evaluation.tables import (
    Style,
    csv_table,
    latex_table,
    notes,
    paper_markdown,
    rich_tables,
)
from neurosym_jax.runtime import files

if TYPE_CHECKING:
    from rich.console import Console

__all__ = [
    "FORMAT",
    "check_replaceable",
    "format_table",
    "further_metrics",
    "show_tables",
    "write_json",
]

FORMAT = 1


def format_table(
    rows: Sequence[Mapping[str, Any]], style: Style = "text", width: int | None = None
) -> str:
    """Rows as tables: one for each test set and horizon and, of several, one of their means.

    Args:
        rows: see `evaluate`; runs whose checkpoints differ in `seed0`, `seed1`, ... are one line.
        style: text for a terminal, or what a paper takes: csv, markdown, latex.
        width: letters of a line of text; default: the terminal's.
    """
    lines = lines_of(rows)
    lines += means_of(lines)
    if style != "text":
        return {"csv": csv_table, "markdown": paper_markdown, "latex": latex_table}[style](lines)
    from rich.console import Console

    # In a notebook, too, it is text.
    console = Console(width=width, force_jupyter=False, color_system=None)
    with console.capture() as text:
        show_tables(lines, console)
    found = "\n".join(line.rstrip() for line in text.get().splitlines())
    return f"{found}\n" + "\n".join(notes(lines, bold=False))


def show_tables(lines: Sequence[Line], console: "Console", *, whole: bool = True) -> None:
    """Print a table for each test set, `whole` or what fits the console's width."""
    for test_set in dict.fromkeys(line.test_set for line in lines):
        members = [line for line in lines if line.test_set == test_set]
        for table in rich_tables(members, console.width, whole=whole):
            console.print(table, "")


def further_metrics(rows: Sequence[Mapping[str, Any]]) -> list[str]:
    """The metrics that all `rows` have beside those of their keys `joint` and `marginal`."""
    both = {f"{protocol}_{error}" for protocol in ("joint", "marginal") for error in ("ade", "fde")}
    # Rows of an earlier version, and no rows, have none.
    names = [name for row in rows[:1] for name in row.get("metrics", {}) if name not in both]
    return [name for name in names if all(row["metrics"].get(name) is not None for row in rows)]


def check_replaceable(path: Path) -> bool:
    """Whether a report is at `path` already.

    Raises:
        InputError: when `path` holds anything but a report, or cannot be written.
    """
    files.refuse_unwritable(path)
    if not path.exists():
        return False
    try:
        old = json.loads(path.read_text())
    except (OSError, ValueError):
        old = None
    if not isinstance(old, dict) or not {"format", "rows"} <= set(old):
        raise InputError(f"{path}: is not a report of ours, so it is not overwritten")
    return True


def write_json(path: Path, data: dict[str, Any]) -> None:
    """Write `data`; a file that is there is replaced only if it is such a report, and said so.

    Raises:
        InputError: when `path` holds anything else, or cannot be written.
    """
    if check_replaceable(path):
        print(f"replacing the report in {path}")
    files.write_json(path, data)
