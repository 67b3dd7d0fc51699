"""TrajNet++ files: a JSON object a line, `{"track": ...}` points and `{"scene": ...}` rows.

A track row has `f` (frame), `p` (pedestrian), `x`, `y` (metres); one with
`prediction_number` is a forecast of the scene `scene_id`, which `Trajnet` skips and
`read_predictions` reads. A scene row names an official scene: its primary person `p`,
first and last frame `s` and `e`, `fps` and `tag`. The format is that of P. Kothari et
al., "Human Trajectory Forecasting in Crowds", IEEE T-ITS 2021 (trajnetplusplustools).
"""

import contextlib
import itertools
import json
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import polars as pl

from neurosym_jax.data.columns import usual_step
from neurosym_jax.data.tables import Format, Head, ReadOptions, Table, read_text_file
from neurosym_jax.data.tracks import Tracks
from neurosym_jax.errors import InputError

__all__ = ["OfficialScene", "Trajnet", "read_predictions", "read_scenes"]

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
        rates, points = [], {}
        for at, kind, fields in _rows(path):
            if kind == "scene":
                rates.append(float(fields.get("fps", FPS)))
            elif fields.get("prediction_number") is None:
                points[at] = [str(fields.get(key)) for key in _KEYS]
        if not points:
            raise InputError(f"{path}: the file has no track rows")
        if len({*rates}) > 1:
            raise InputError(f"{path}: scenes differ in fps")
        texts = pl.Series(points.values(), dtype=pl.List(pl.String))
        table = Table(path, _KEYS, texts, np.array(list(points)))
        ids, people = table.ids(1)
        frame = table.whole_numbers(0)
        order = np.lexsort((frame, ids))
        step = frame / usual_step(frame[order], ids[order])
        stamp = step / (rates[-1] if rates else FPS)
        rate = options.fps_of(path.stem)
        if rate:
            stamp = frame / rate
        position = table.numbers(2, 3)
        return table.tracks(stamp, ids, position, frame=frame, people=people)


class OfficialScene(NamedTuple):
    """A scene that a file lists: from frame `start` to `end`, of whom `person` is the primary."""

    id: int
    person: int
    start: int
    end: int
    fps: float
    tag: Any


def read_scenes(path: Path) -> list[OfficialScene]:
    """The scene rows of a file, in its order.

    Raises:
        InputError: naming file, row and reason.
    """
    scenes = []
    for at, kind, fields in _rows(path):
        if kind == "scene":
            keys = ("id", "p", "s", "e")
            numbers = [int(_number(path, at, fields, key)) for key in keys]
            id, person, start, end = numbers
            rate = float(fields.get("fps", FPS))
            tag = _numeric(fields.get("tag"))
            scenes.append(OfficialScene(id, person, start, end, rate, tag))
    return scenes


def read_predictions(path: Path) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The forecasts of a file as samples [k, A, T, 2], ids [A] and last observed frames [A].

    Scenes that begin together forecast the same people more than once; the first one
    counts. A forecast of one step does not say how far frames are apart: the frame
    before it counts.

    Raises:
        InputError: naming file and row, for forecasts that are not of one number and
            length.
    """
    forecasts: dict[tuple[int, int], np.ndarray] = {}
    for (scene, person), points in _predicted_points(path).items():
        samples = sorted({sample for sample, _ in points})
        frames = sorted({frame for _, frame in points})
        step = frames[1] - frames[0] if len(frames) > 1 else 1
        is_complete = len(samples) * len(frames) == len(points)
        if not is_complete or (np.diff(frames) != step).any():
            raise InputError(
                f"{path}: scene {scene}, person {person}: steps are missing"
            )
        ordered = [points[key] for key in itertools.product(samples, frames)]
        forecast = np.reshape(ordered, (len(samples), len(frames), 2))
        forecasts.setdefault((person, frames[0] - step), forecast)
    shapes = sorted({forecast.shape[:2] for forecast in forecasts.values()})
    if len(shapes) > 1:
        kinds = " and ".join(f"{k} x {steps}" for k, steps in shapes[:2])
        raise InputError(f"{path}: forecasts of {kinds} samples and steps in one file")
    ids, frames = np.array(list(forecasts)).T
    return np.stack(list(forecasts.values()), axis=1), ids, frames


def _predicted_points(
    path: Path,
) -> dict[tuple[int, int], dict[tuple[int, int], list[float]]]:
    """x and y by (sample, frame) of each (scene, person) that a file forecasts.

    Raises:
        InputError: for rows that stand twice, and a file without forecasts.
    """
    paths = {}
    for at, kind, fields in _rows(path):
        if kind != "track" or fields.get("prediction_number") is None:
            continue
        keys = ("scene_id", "p", "f", "prediction_number")
        numbers = [int(_number(path, at, fields, key)) for key in keys]
        scene, person, frame, sample = numbers
        point = [_number(path, at, fields, key) for key in ("x", "y")]
        points = paths.setdefault((scene, person), {})
        if (sample, frame) in points:
            raise InputError(
                f"{path}: row {at}: repeats sample {sample} of person {person}"
            )
        points[sample, frame] = point
    if not paths:
        raise InputError(
            f"{path}: the file has no forecasts (rows with prediction_number)"
        )
    return paths


def _numeric(tag: Any) -> Any:
    """A tag, whose numbers are text, with numbers."""
    if isinstance(tag, list):
        return [_numeric(part) for part in tag]
    is_number = isinstance(tag, str) and tag.lstrip("-").isdigit()
    return int(tag) if is_number else tag


def _number(path: Path, at: int, fields: dict[str, Any], key: str) -> float:
    """A finite number of a row."""
    number = np.nan
    with contextlib.suppress(KeyError, TypeError, ValueError):
        number = float(fields[key])
    if not np.isfinite(number):
        text = f"{key} is not a number: {fields.get(key)!r}"
        raise InputError(f"{path}: row {at}: {text}"[:300])
    return number


def _rows(path: Path) -> list[tuple[int, str, dict[str, Any]]]:
    """Line, kind and fields of each row; numbers stay the text that they are."""
    rows = []
    for at, line in enumerate(read_text_file(path).split("\n"), 1):
        if line.strip():
            rows.append((at, *_content(path, at, line)))
    return rows


def _content(path: Path, at: int, line: str) -> tuple[str, dict[str, Any]]:
    """Kind and fields of a line; numbers stay the text that they are."""
    try:
        content = json.loads(line, parse_float=str, parse_int=str)
        ((kind, fields),) = content.items()
        if kind in ("track", "scene") and float(fields.get("fps", FPS)) > 0:
            return kind, fields
    except (ValueError, TypeError, AttributeError, RecursionError):
        pass
    raise InputError(
        f"{path}: row {at}: neither a track nor a scene in JSON: {line[:60]!r}"
    )
