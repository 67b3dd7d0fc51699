"""TrajNet++ files: a JSON object a line, `{"track": ...}` points and `{"scene": ...}` rows.

A track row has `f` (frame), `p` (pedestrian), `x`, `y` (metres); one with `prediction_number` is a
forecast and is skipped. Only `fps` is read of a scene row. The format is that of P. Kothari et al.,
"Human Trajectory Forecasting in Crowds", IEEE T-ITS 2021 (trajnetplusplustools).
"""

import json
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl

from neurosym_jax.data.reading import Format, Head, ReadOptions, read_text_file
from neurosym_jax.data.table import Table
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
        return head.lines[0].replace(" ", "").startswith(('{"track":{', '{"scene":{'))

    def read(self, path: Path, options: ReadOptions, period: float) -> list[Tracks]:
        """The points of one ndjson file; the most common step of frame numbers is 1/fps seconds.

        Raises:
            InputError: naming file, row and reason.
        """
        lines = enumerate(read_text_file(path).split("\n"), 1)
        found = [(at, *_content(path, at, line)) for at, line in lines if line.strip()]
        rates = [float(fields.get("fps", FPS)) for _, kind, fields in found if kind == "scene"]
        points = {
            at: [str(fields.get(key)) for key in _KEYS]
            for at, kind, fields in found
            if kind == "track" and fields.get("prediction_number") is None
        }
        if not points or len({*rates}) > 1:
            why = "scenes differ in fps" if points else "the file has no track rows"
            raise InputError(f"{path}: {why}")
        texts = pl.Series(points.values(), dtype=pl.List(pl.String))
        table = Table(path, _KEYS, texts, np.array(list(points)))
        ids = table.ids(1)
        stamp = table.times(0, ids, options, 1 / (rates or [FPS])[-1], any_step=True)
        return table.tracks(stamp, ids, table.numbers(2, 3))


def _content(path: Path, at: int, line: str) -> tuple[str, dict[str, Any]]:
    """Kind and fields of a line; numbers stay the text that they are."""
    try:
        ((kind, fields),) = json.loads(line, parse_float=str, parse_int=str).items()
        if kind in ("track", "scene") and float(fields.get("fps", FPS)) > 0:
            return kind, fields
    except (ValueError, TypeError, AttributeError, RecursionError):
        pass
    raise InputError(f"{path}: row {at}: neither a track nor a scene in JSON: {line[:60]!r}")
