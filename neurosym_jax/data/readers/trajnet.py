"""TrajNet++ files: a JSON object a line, `{"track": ...}` points and `{"scene": ...}` rows.

A track row has `f` (frame), `p` (pedestrian), `x`, `y` (metres); one with `prediction_number` is a
forecast and is skipped. Of a scene row only `fps` is read. The format is that of P. Kothari, S.
Kreiss and A. Alahi, "Human Trajectory Forecasting in Crowds", IEEE T-ITS 2021
(trajnetplusplustools).
"""

from pathlib import Path
from typing import Any

import numpy as np
import polars as pl

from neurosym_jax.data.json_rows import json_lines, json_text
from neurosym_jax.data.reading import AS_IT_SAYS, ReadOptions
from neurosym_jax.data.rows import assemble
from neurosym_jax.data.tables import TEXTS, Table
from neurosym_jax.data.tracks import PERIOD, Tracks, common
from neurosym_jax.errors import InputError

__all__ = ["read_trajnet"]

FPS = 2.5
"""Frames a second where no scene row says."""

_KEYS = ("f", "p", "x", "y")


def read_trajnet(path: Path, options: ReadOptions = AS_IT_SAYS, period: float = PERIOD) -> Tracks:
    """Read one ndjson file.

    A step is 1/fps seconds and `stride` frame numbers; default: their most common step.

    Raises:
        InputError: naming file, row and reason.
    """
    texts: list[list[str | None]] = []
    row: list[int] = []
    fps, skipped = None, 0
    for at, content in json_lines(path):
        kind, fields = _row(path, at, content)
        if kind == "scene":
            rate = _rate(path, at, fields.get("fps", str(FPS)))
            if fps not in (None, rate):
                raise InputError(f"{path}: row {at}: fps {rate:g}, and {fps:g} before")
            fps = rate
        elif fields.get("prediction_number") is not None:
            skipped += 1
        else:
            texts.append([json_text(fields.get(key)) for key in _KEYS])
            row.append(at)
    if not texts:
        raise InputError(f"{path}: the file has no track rows")
    table = Table(path, _KEYS, pl.Series(texts, dtype=TEXTS), np.array(row))
    frame = table.whole_numbers(0)
    table.whole_numbers(1)
    steps = np.diff(np.unique(frame))
    step = options.stride_of(path, period) or (common(steps) if len(steps) else 1.0)
    return assemble(
        path,
        frame / step / (fps or FPS),
        table.ids(1),
        table.numbers(2, 3),
        row=table.row,
        skipped=skipped,
    )


def _row(path: Path, at: int, row: Any) -> tuple[str, dict[str, Any]]:
    """Kind and content of one line."""
    if isinstance(row, dict) and len(row) == 1:
        ((kind, content),) = row.items()
        if kind in ("track", "scene") and isinstance(content, dict):
            return kind, content
    raise InputError(f"{path}: row {at}: neither a track nor a scene: {str(row)[:60]!r}")


def _rate(path: Path, at: int, value: Any) -> float:
    try:
        rate = float(value)
    except (TypeError, ValueError):
        rate = 0.0
    if not 1e-3 <= rate <= 1e4:
        raise InputError(f"{path}: row {at}: fps is {str(value)[:40]}")
    return rate
