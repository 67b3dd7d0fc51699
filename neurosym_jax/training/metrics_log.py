"""`metrics.jsonl`: the measurements of a run, a row a line, appended while it runs."""

import json
from pathlib import Path
from typing import Any

from neurosym_jax.runtime.files import append_text, write_text

__all__ = ["MetricsLog"]


class MetricsLog:
    """The rows so far, on the disk.

    Rows beyond the step that a run resumes from, and half a line that a kill left, are dropped: a
    resumed run writes the same file as an undisturbed one.
    """

    def __init__(self, path: Path, step: int):
        self._path = path
        kept = [row for row in self.rows() if row["step"] <= step]
        write_text(path, "".join(json.dumps(row) + "\n" for row in kept))

    def append(self, row: dict[str, Any]) -> None:
        """Add one row, which has a `step`.

        Raises:
            InputError: where it cannot be written.
        """
        append_text(self._path, json.dumps(row, allow_nan=False) + "\n")

    def rows(self) -> list[dict[str, Any]]:
        """All rows before the first damaged line."""
        rows = []
        for line in self._path.read_bytes().splitlines() if self._path.exists() else ():
            try:
                rows.append(json.loads(line))
            except ValueError:
                break
        return rows
