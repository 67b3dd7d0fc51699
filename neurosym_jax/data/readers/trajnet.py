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

from neurosym_jax.data.json_rows import decode_json, json_text
from neurosym_jax.data.rows import assemble, frame_step
from neurosym_jax.data.tables import TEXTS, Table
from neurosym_jax.data.text import read_lines
from neurosym_jax.data.tracks import Tracks
from neurosym_jax.errors import InputError

__all__ = ["read_trajnet"]

FPS = 2.5
"""Frames a second where no scene row says."""

_KEYS = ("f", "p", "x", "y")


def read_trajnet(path: Path, stride: float | None = None) -> Tracks:
    """Read one ndjson file.

    A period is 1/fps seconds and `stride` frame numbers; default: their most common step.

    Raises:
        InputError: naming file, row and reason.
    """
    texts: list[list[str | None]] = []
    row: list[int] = []
    fps, skipped = None, 0
    for at, line in enumerate(read_lines(path), 1):
        if not line.strip():
            continue
        kind, fields = _row(path, at, line)
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
    stamp = frame / frame_step(path, frame, stride) * (1 / (fps or FPS))
    return assemble(path, stamp, table.ids(1), table.numbers(2, 3), row=table.row, skipped=skipped)


def _row(path: Path, at: int, line: str) -> tuple[str, dict[str, Any]]:
    """Kind and content of one line."""
    try:
        row = decode_json(line)
    except ValueError as error:
        raise InputError(f"{path}: row {at}: not JSON ({str(error)[:60]})") from None
    if isinstance(row, dict) and len(row) == 1:
        ((kind, content),) = row.items()
        if kind in ("track", "scene") and isinstance(content, dict):
            return kind, content
    shown = line.strip()[:60]
    raise InputError(f"{path}: row {at}: neither a track nor a scene: {shown!r}")


def _rate(path: Path, at: int, value: Any) -> float:
    try:
        rate = float(value)
    except (TypeError, ValueError):
        rate = 0.0
    if not 1e-3 <= rate <= 1e4:
        raise InputError(f"{path}: row {at}: fps is {str(value)[:40]}")
    return rate
