"""TrajNet++ files: a JSON object a line, `{"track": ...}` points and `{"scene": ...}` rows.

A track row has `f` (frame), `p` (pedestrian), `x`, `y` (metres); one with `prediction_number` is a
forecast, and skipped. A scene row has `fps`, and who is to be forecast when, which is not read. The
format is that of P. Kothari, S. Kreiss and A. Alahi, "Human Trajectory Forecasting in Crowds", IEEE
T-ITS 2021 (trajnetplusplustools).
"""

import json
from array import array
from pathlib import Path
from typing import Any

import numpy as np

from neurosym_jax.data.format import Format
from neurosym_jax.data.rows import People, assemble, frame_step
from neurosym_jax.data.text import Head, decode_json, number, read_lines
from neurosym_jax.data.tracks import Tracks
from neurosym_jax.errors import InputError

__all__ = ["FORMATS", "read_trajnet"]

FPS = 2.5
"""Frames a second where no scene row says."""


def read_trajnet(path: Path, stride: float | None = None) -> Tracks:
    """Read one ndjson file.

    A period is 1/fps seconds and `stride` frame numbers: the most common step if None.

    Raises:
        InputError: naming file, row and reason.
    """
    path = Path(path)
    people, codes, row = People(path), array("q"), array("q")
    frames, x, y = array("d"), array("d"), array("d")
    fps, skipped = None, 0
    for at, line in enumerate(read_lines(path), 1):
        if not line.strip():
            continue
        kind, fields = _row(path, at, line)
        if kind == "scene":
            rate = _real(path, at, fields, "fps") if "fps" in fields else FPS
            if not 1e-3 <= rate <= 1e4:
                raise InputError(f"{path}: row {at}: fps is {rate:g}")
            if fps not in (None, rate):
                raise InputError(f"{path}: row {at}: fps {rate:g}, and {fps:g} before")
            fps = rate
        elif fields.get("prediction_number") is not None:
            skipped += 1
        else:
            _whole(path, at, fields, "p")
            codes.append(people.code(fields["p"], at))
            frames.append(_whole(path, at, fields, "f"))
            x.append(_real(path, at, fields, "x"))
            y.append(_real(path, at, fields, "y"))
            row.append(at)
    if not codes:
        raise InputError(f"{path}: the file has no track rows")
    frame = np.array(frames)
    stamp = frame / frame_step(path, frame, stride) * (1 / (fps or FPS))
    position = np.stack([np.array(x), np.array(y)], axis=1)
    ids = people.numbers(codes)
    return assemble(path, stamp, ids, position, row=np.array(row), skipped=skipped)


def _row(path: Path, at: int, line: str) -> tuple[str, dict[str, Any]]:
    """Kind and content of one line."""
    try:
        row = decode_json(line)
    except ValueError as error:
        raise InputError(f"{path}: row {at} is not JSON ({str(error)[:60]})") from None
    if isinstance(row, dict) and len(row) == 1:
        ((kind, content),) = row.items()
        if kind in ("track", "scene") and isinstance(content, dict):
            return kind, content
    raise InputError(f"{path}: row {at} is neither a track nor a scene: {line.strip()[:60]!r}")


def _real(path: Path, at: int, row: dict[str, Any], key: str) -> float:
    try:
        value = number(row.get(key))
        if abs(value) < 1e300:
            return value
    except (TypeError, ValueError, OverflowError):
        pass
    raise InputError(f"{path}: row {at}: {key} is {str(row.get(key))[:40]!r}, not a usable number")


def _whole(path: Path, at: int, row: dict[str, Any], key: str) -> float:
    value = _real(path, at, row, key)
    if abs(value) > 2.0**53 or value != round(value):
        raise InputError(f"{path}: row {at}: {key} {value:g} is not a whole number")
    return value


def _is_trajnet(head: Head) -> bool:
    try:
        row = json.loads(head.first)
    except (ValueError, RecursionError):
        # A row cut short is TrajNet++ still, and its reader says which.
        return head.first.startswith(('{"track"', '{"scene"'))
    return isinstance(row, dict) and row.keys() in ({"track"}, {"scene"})


FORMATS = {
    "trajnet": Format(
        "TrajNet++",
        _is_trajnet,
        lambda path, how, _: [read_trajnet(path, how.stride_of(path))],
        uses=frozenset({"stride"}),
    ),
}
