"""TrajNet++ files: a JSON object a line, `{"track": ...}` points and `{"scene": ...}` rows.

A track row has `f` (frame), `p` (pedestrian), `x`, `y` (metres); one with `prediction_number` is a
forecast and is skipped. Of a scene row only `fps` is read. The format is that of P. Kothari et al.,
"Human Trajectory Forecasting in Crowds", IEEE T-ITS 2021 (trajnetplusplustools).
"""

import json
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl

from neurosym_jax.data.reading import Format, ReadOptions
from neurosym_jax.data.table import Table, assemble
from neurosym_jax.data.text import Head, read_text_file
from neurosym_jax.data.tracks import Tracks
from neurosym_jax.errors import InputError

__all__ = ["Trajnet"]

FPS = 2.5  # steps a second where no scene row says
_KEYS = ("f", "p", "x", "y")


class Trajnet(Format):
    """TrajNet++."""

    title = "TrajNet++"
    uses = frozenset({"fps"})

    def knows(self, head: Head) -> bool:
        """Also a first row that is cut short, which the reader reports."""
        return head.first.replace(" ", "").startswith(('{"track":{', '{"scene":{'))

    def read(self, path: Path, options: ReadOptions, period: float) -> list[Tracks]:
        """The points of one ndjson file; the most common step of frame numbers is 1/fps seconds.

        Raises:
            InputError: naming file, row and reason.
        """
        points: list[list[str]] = []
        row: list[int] = []
        rate = FPS
        for at, line in enumerate(read_text_file(path).split("\n"), 1):
            if not line.strip():
                continue
            kind, fields = _content(path, at, line)
            if kind == "scene":
                rate = float(fields.get("fps", FPS))
            elif fields.get("prediction_number") is None:
                points.append([str(fields.get(key)) for key in _KEYS])
                row.append(at)
        if not points:
            raise InputError(f"{path}: the file has no track rows")
        table = Table(path, _KEYS, pl.Series(points, dtype=pl.List(pl.String)), np.array(row))
        stamp = table.times(0, options, 1 / rate, any_step=True)
        return [assemble(path, table.row, stamp, table.ids(1), table.numbers(2, 3))]


def _content(path: Path, at: int, line: str) -> tuple[str, dict[str, Any]]:
    """Kind and fields of a line; numbers stay the text that they are."""
    try:
        ((kind, fields),) = json.loads(line, parse_float=str, parse_int=str).items()
        if kind in ("track", "scene") and float(fields.get("fps", FPS)) > 0:
            return kind, fields
    except (ValueError, TypeError, AttributeError, RecursionError):
        pass
    raise InputError(f"{path}: row {at}: neither a track nor a scene in JSON: {line[:60]!r}")
