"""`metrics.jsonl`: what a run measured, one row a line, appended to while it goes on."""

import json
import os
from pathlib import Path
from typing import Any

__all__ = ["MetricsLog"]


class MetricsLog:
    """The rows of the steps so far, on the disk.

    Rows beyond the step that a run resumes from, and half a line that a kill left, are dropped, so
    that a resumed run writes the file that it would have written undisturbed.
    """

    def __init__(self, path: Path, step: int):
        self._path = path
        path.parent.mkdir(parents=True, exist_ok=True)
        kept = [row for row in self.rows() if row["step"] <= step]
        scratch = path.with_suffix(".part")
        scratch.write_text("".join(json.dumps(row) + "\n" for row in kept))
        os.replace(scratch, path)

    def append(self, row: dict[str, Any]) -> None:
        """Add one row, which has a `step`."""
        with self._path.open("a") as file:
            file.write(json.dumps(row) + "\n")

    def rows(self) -> list[dict[str, Any]]:
        """All rows, as far as the file is whole."""
        rows = []
        for line in self._path.read_text().splitlines() if self._path.exists() else ():
            try:
                rows.append(json.loads(line))
            except ValueError:
                break
        return rows
