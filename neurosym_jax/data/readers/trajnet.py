"""TrajNet++ files: a JSON object a line, `{"track": ...}` points and `{"scene": ...}` rows.

A track row has `f` (frame), `p` (pedestrian), `x`, `y` (metres), and, where it is a forecast,
`prediction_number` and `scene_id`. A scene row has `id`, `p` (primary pedestrian), `s` and `e`
(first and last frame), `fps` and, sometimes, `tag`. The format is that of P. Kothari, S. Kreiss
and A. Alahi, "Human Trajectory Forecasting in Crowds", IEEE T-ITS 2021 (trajnetplusplustools).
"""

import dataclasses
import json
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from neurosym_jax.data.readers.rows import LATE, assemble, frame_step, load_text
from neurosym_jax.data.tracks import SNAP, Tracks
from neurosym_jax.errors import InputError

__all__ = ["TrajnetFile", "TrajnetForecast", "TrajnetScene", "read_trajnet", "write_trajnet"]

FPS = 2.5
"""Frames a second where no scene row says."""

_WHOLE = 2**53


@dataclasses.dataclass(frozen=True)
class TrajnetScene:
    """One scene row."""

    id: int
    person: int
    """The primary pedestrian."""
    start: float
    """Seconds on the recording's clock: the scene's first frame."""
    end: float
    """Seconds: its last frame."""
    tag: Any = None
    """As in the file; JSON."""


@dataclasses.dataclass(frozen=True, eq=False)
class TrajnetForecast:
    """One person's forecast."""

    scene: int
    """Id of the scene."""
    sample: int
    """`prediction_number`."""
    person: int
    start: float
    """Seconds on the recording's clock: the stamp of the first position."""
    position: np.ndarray
    """[T, 2] float64 metres, a period apart."""


@dataclasses.dataclass(frozen=True, eq=False)
class TrajnetFile:
    """What a file holds."""

    tracks: Tracks
    period: float
    """Seconds between frames."""
    scenes: tuple[TrajnetScene, ...] = ()
    forecasts: tuple[TrajnetForecast, ...] = ()


def read_trajnet(path: Path, stride: float | None = None) -> TrajnetFile:
    """Read one ndjson file.

    A period is 1/fps seconds and `stride` frame numbers: the most common step if None.

    Raises:
        InputError: naming file, row and reason.
    """
    path = Path(path)
    points: list[tuple[int, int, float, float]] = []
    scenes: list[tuple[dict[str, Any], list[int]]] = []
    forecasts: dict[tuple[int, int, int], dict[int, tuple[float, float]]] = {}
    fps = None
    # str.splitlines would also split at characters that JSON allows inside a text.
    for number, line in enumerate(load_text(path).split("\n"), 1):
        if not line.strip():
            continue
        kind, row = _row(path, number, line)
        if kind == "scene":
            scenes.append((row, [_whole(path, number, row, key) for key in ("id", "p", "s", "e")]))
            rate = _real(path, number, row, "fps") if "fps" in row else FPS
            if not 1e-3 <= rate <= 1e4:
                raise InputError(f"{path}: row {number}: fps is {rate:g}")
            if fps not in (None, rate):
                raise InputError(f"{path}: row {number}: fps {rate:g}, and {fps:g} before")
            fps = rate
            continue
        frame, person = (_whole(path, number, row, key) for key in ("f", "p"))
        x, y = (_real(path, number, row, key) for key in ("x", "y"))
        if row.get("prediction_number") is None:
            points.append((frame, person, x, y))
            continue
        scene, sample = (_whole(path, number, row, k) for k in ("scene_id", "prediction_number"))
        forecast = forecasts.setdefault((scene, sample, person), {})
        if frame in forecast:
            raise InputError(f"{path}: row {number} repeats a forecast (f {frame}, p {person})")
        forecast[frame] = (x, y)
    if not points:
        raise InputError(f"{path}: the file has no track rows")

    frame = np.array([point[0] for point in points], np.float64)
    period = 1 / (fps or FPS)
    step = frame_step(path, frame, stride)
    tracks = assemble(
        path, frame / step * period, [p[1] for p in points], np.array([p[2:] for p in points])
    )
    return TrajnetFile(
        tracks,
        period,
        tuple(
            TrajnetScene(id, person, start / step * period, end / step * period, row.get("tag"))
            for row, (id, person, start, end) in scenes
        ),
        tuple(
            TrajnetForecast(*key, min(way) / step * period, np.array([way[f] for f in sorted(way)]))
            for key, way in forecasts.items()
        ),
    )


def write_trajnet(
    path: Path,
    tracks: Tracks,
    scenes: Sequence[TrajnetScene] = (),
    forecasts: Iterable[TrajnetForecast] = (),
    period: float = 1 / FPS,
) -> Path:
    """Write a file; frame n is at n periods on the recording's clock.

    Args:
        path: of the file; its folders are created.
        tracks: on a grid of `period` that meets second 0.
        scenes: rows that say who is to be forecast, and when.
        forecasts: written after the tracks, with their scene and sample.
        period: seconds between frames.

    Raises:
        InputError: for a stamp that is not on the grid, or forecasts not [T, 2] and finite.
    """
    path = Path(path)
    name = tracks.recording
    lines: list[dict[str, Any]] = []
    for scene in scenes:
        start, end = (_frame(name, stamp, period) for stamp in (scene.start, scene.end))
        row = {"id": scene.id, "p": scene.person, "s": start, "e": end, "fps": 1 / period}
        lines.append({"scene": row if scene.tag is None else {**row, "tag": scene.tag}})
    order = np.lexsort((tracks.id, tracks.stamp))
    for at in order.tolist():
        frame = _frame(name, float(tracks.stamp[at]), period)
        x, y = tracks.position[at].tolist()
        lines.append({"track": {"f": frame, "p": int(tracks.id[at]), "x": x, "y": y}})
    for forecast in forecasts:
        position = np.asarray(forecast.position, np.float64)
        if position.ndim != 2 or position.shape[1] != 2 or not np.isfinite(position).all():
            raise InputError(f"{name}: a forecast must be [T, 2] and finite")
        first = _frame(name, forecast.start, period)
        about = {"prediction_number": forecast.sample, "scene_id": forecast.scene}
        for frame, (x, y) in enumerate(position.tolist(), first):
            lines.append({"track": {"f": frame, "p": forecast.person, "x": x, "y": y, **about}})
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text("".join(json.dumps(line) + "\n" for line in lines), encoding="utf-8")
    return path


def _frame(name: str, stamp: float, period: float) -> int:
    if not (period > SNAP and abs(stamp) < LATE):
        raise InputError(f"{name}: {stamp} s in periods of {period} s is not usable")
    frame = round(stamp / period)
    if abs(stamp - frame * period) > SNAP:
        raise InputError(f"{name}: {stamp} s is not a multiple of {period:g} s: resample first")
    return frame


def _row(path: Path, number: int, line: str) -> tuple[str, dict[str, Any]]:
    """Kind and content of one line."""
    try:
        row = json.loads(line)
    except (ValueError, RecursionError):
        raise InputError(f"{path}: row {number} is not JSON: {line[:60]!r}") from None
    if isinstance(row, dict) and len(row) == 1:
        ((kind, content),) = row.items()
        if kind in ("track", "scene") and isinstance(content, dict):
            return kind, content
    raise InputError(f"{path}: row {number} is neither a track nor a scene: {line[:60]!r}")


def _real(path: Path, number: int, row: dict[str, Any], key: str) -> float:
    value = row.get(key)
    # Python's JSON knows whole numbers larger than any float.
    if isinstance(value, int | float) and not isinstance(value, bool) and abs(value) < 1e300:
        return float(value)
    raise InputError(f"{path}: row {number}: {key} is {str(value)[:40]!r}, not a usable number")


def _whole(path: Path, number: int, row: dict[str, Any], key: str) -> int:
    value = _real(path, number, row, key)
    if abs(value) > _WHOLE or value != round(value):
        raise InputError(f"{path}: row {number}: {key} {value:g} is not a whole number")
    return int(value)
