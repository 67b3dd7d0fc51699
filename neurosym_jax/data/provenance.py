"""Where a recording comes from and how it was read: what people, cards and JSON are told of it."""

import dataclasses
from typing import Any

__all__ = ["Reading"]


@dataclasses.dataclass(frozen=True)
class Reading:
    """How a recording came to be."""

    recording: str
    file: str | None = None
    """Where it was read from; None for what no file holds."""
    format: str | None = None
    """Name of the file's format, see `data.formats`."""
    rows: int = 0
    """Rows, or points, that were read."""
    skipped: int = 0
    """Rows that were left out, because they are no observation of a person."""
    frame_step: float | None = None
    """Frame numbers that were taken for one step, because nobody said how many a second has."""
    runs: int = 1
    """Parts between gaps in time, which windows do not cross; once they are cut."""
    gaps: int = 0
    """Gaps in time between the runs."""
    warnings: tuple[str, ...] = ()
    """What looks wrong, a line each."""

    def to_json(self) -> dict[str, Any]:
        """The fields by name."""
        return {**dataclasses.asdict(self), "warnings": list(self.warnings)}
