"""Forecasts in files: our own, CSV, xarray's, and TrajNet++'s."""

import json
import re
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from neurosym_jax.data.readers.trajnet import OfficialScene, Trajnet, read_scenes
from neurosym_jax.data.tables import AS_IT_SAYS
from neurosym_jax.data.tracks import PERIOD
from neurosym_jax.data.windows import Windows, make_batches
from neurosym_jax.errors import InputError, optional_module
from neurosym_jax.evaluation.compare import Test
from neurosym_jax.evaluation.forecasts import (
    csv_of_forecasts,
    last_frames,
    recording_names,
)
from neurosym_jax.models.forecast import Model, forecast_windows
from neurosym_jax.models.histories import fill_history
from neurosym_jax.runtime.files import new_file, refuse_unwritable
from neurosym_jax.runtime.process import cpu_cores, refuse_beyond_memory
from neurosym_jax.scene import scene_identity

__all__ = [
    "DECIMALS",
    "check_forecasts_file",
    "forecasts_of",
    "save_forecasts",
    "to_xarray",
    "write_trajnet",
]


# Forecasts as TrajNet++ files, with the frames, people, scenes and tags of the
# recording.
#
# TrajNet++'s evaluator reads two files, what happened and what was forecast. It counts
# the forecast of each scene's primary person, and its collisions (Col-I) where every
# neighbour is forecast who was seen at any observed step. So the scenes that a TrajNet++
# recording lists are forecast for all of these; steps at which they were not seen are
# filled at constant velocity. Other recordings have a scene for each window, whose people
# are there throughout.

DECIMALS = 4
"""Decimals of metres in files."""
Points = dict[tuple[int, int], np.ndarray]
"""[2] metres by (frame, person)."""


class ObservedScene(NamedTuple):
    """A scene, and its N people as they were observed, of whom the primary comes first."""

    scene: OfficialScene
    people: np.ndarray
    """[N] ids."""
    observed: np.ndarray
    """[N, obs_len, 2] metres."""
    frames: np.ndarray
    """[T] frames to forecast."""


def write_trajnet(
    target: Path, model: Model, test: Test, samples: int, seed: int
) -> Path:
    """Write forecasts of a test set to `target`; what happened, to `NAME_truth.ndjson` beside it.

    Returns the path of the latter.
    """
    points, scenes = _official(test) or _of_windows(test)
    truth = target.with_stem(f"{target.stem}_truth")
    header = _lines([_scene(seen.scene) for seen in scenes])
    with new_file(truth) as beside, beside.open("w", encoding="utf-8") as file:
        file.write(header)
        for (frame, person), xy in sorted(points.items()):
            file.write(_lines([_track(frame, person, xy)]))
    with new_file(target) as beside, beside.open("w", encoding="utf-8") as file:
        file.write(header)
        for seen, futures in _forecasts(model, test, scenes, samples, seed):
            file.write(_lines(_predictions(seen, futures)))
    return truth


def _official(test: Test) -> tuple[Points, list[ObservedScene]] | None:
    """The points and the scenes of a TrajNet++ recording; None where the test set is another."""
    windows = test.windows
    (reading, *others) = windows.reading
    if others or reading.format != "trajnet" or not reading.file:
        return None
    file = Path(reading.file)
    listed = read_scenes(file)
    if not listed:
        return None
    period = 1 / listed[0].fps
    if abs(windows.period - period) > 0.01 * windows.period:
        return None
    (tracks,) = Trajnet().read(file, AS_IT_SAYS, PERIOD)
    rate = reading.rate or 1
    frames = np.rint(tracks.stamp * rate).astype(int)
    keys = zip(frames.tolist(), tracks.id.tolist())
    points = dict(zip(keys, tracks.position))
    people_at: dict[int, list[int]] = {}
    for frame, person in points:
        people_at.setdefault(frame, []).append(person)

    obs_len = test.test_set.obs_len
    pred_len = test.test_set.pred_len
    scenes = []
    for scene in listed:
        steps = np.arange(scene.start, scene.end + 1, round(windows.period * rate))
        past = steps[:-pred_len].tolist()
        if len(past) < obs_len:
            raise InputError(
                f"{file}: scene {scene.id} has {len(steps)} steps, not {obs_len} + {pred_len}"
            )
        neighbours: set[int] = set()
        for frame in past:
            neighbours.update(people_at.get(frame, ()))
        people = [scene.person, *sorted(neighbours - {scene.person})]
        paths = np.full((len(people), len(past), 2), np.nan)
        for path, person in zip(paths, people):
            for step, frame in enumerate(past):
                path[step] = points.get((frame, person), np.nan)
        observed, _ = fill_history(paths, f"{file}: scene {scene.id}")
        ids = np.array(people)
        future = steps[-pred_len:]
        scenes.append(ObservedScene(scene, ids, observed[:, -obs_len:], future))
    return points, scenes


def _of_windows(test: Test) -> tuple[Points, list[ObservedScene]]:
    """The points and a scene for each window. Of several recordings, frames and people are numbered
    consecutively, because a file is one recording; and people whose ids are texts."""
    windows = test.windows
    names = recording_names(windows)
    steps = windows.position.shape[1]
    rate = windows.reading[0].rate if len(windows.reading) == 1 else None
    renumbered = rate is None
    # TrajNet++'s people are numbers.
    is_named = renumbered or windows.agent.dtype.kind == "U"
    if rate is None:
        last = windows.identity[:, 1].astype(int) + windows.obs_len - 1
        stride = 1
    else:
        last = np.rint(last_frames(windows)).astype(int)
        stride = round(rate * windows.period)
    step = stride * (np.arange(steps) - windows.obs_len + 1)
    fps = round(1 / windows.period, 6)
    shift = 0
    numbers: dict[tuple[str, int], int] = {}
    points: Points = {}
    scenes = []
    for name in dict.fromkeys(names.tolist()):
        for at in np.flatnonzero(names == name):
            rows = slice(*windows.bounds[at : at + 2])
            frames = last[at] + shift + step
            people = windows.agent[rows]
            if is_named:
                keys = [(name, person) for person in people.tolist()]
                people = [numbers.setdefault(key, len(numbers)) for key in keys]
                people = np.array(people)
            for person, path in zip(people.tolist(), windows.position[rows]):
                for frame, xy in zip(frames.tolist(), path):
                    points[frame, person] = xy
            primary, start, end = int(people[0]), int(frames[0]), int(frames[-1])
            scene = OfficialScene(int(at), primary, start, end, fps, [0, []])
            observed = windows.position[rows, : windows.obs_len]
            future = frames[windows.obs_len :]
            scenes.append(ObservedScene(scene, people, observed, future))
        if renumbered:
            shift = max(frame for frame, _ in points) + 1
    return points, scenes


def _forecasts(
    model: Model, test: Test, scenes: list[ObservedScene], samples: int, seed: int
) -> Iterator[tuple[ObservedScene, np.ndarray]]:
    """Each scene and [k, N, T, 2] metres, its most probable sample first.

    The noise is that of the windows where the scenes are these.
    """
    sizes = [len(seen.people) for seen in scenes]
    bounds = np.append(0, np.cumsum(sizes))
    identity = test.windows.identity
    if not np.array_equal(bounds, test.windows.bounds):
        numbers = np.array([seen.scene.id for seen in scenes])
        identity = scene_identity(test.windows.reading[0].recording, numbers)
    windows = Windows(
        np.concatenate([seen.observed for seen in scenes]),
        np.concatenate([seen.people for seen in scenes]),
        bounds,
        identity,
        test.test_set.obs_len,
        test.windows.period,
    )
    futures, likely = forecast_windows(
        model, windows, make_batches(windows), samples, seed
    )
    for number, seen in enumerate(scenes):
        own_samples = futures[:, slice(*bounds[number : number + 2])]
        if likely is not None:
            # The evaluator takes number 0 for the best guess.
            order = np.argsort(-likely[:, number], kind="stable")
            own_samples = own_samples[order]
        yield seen, own_samples


def _predictions(seen: ObservedScene, samples: np.ndarray) -> Iterator[dict[str, Any]]:
    for number, sample in enumerate(samples):
        for person, path in zip(seen.people.tolist(), sample):
            for frame, xy in zip(seen.frames.tolist(), path):
                row = _track(frame, person, xy)
                row["track"]["prediction_number"] = number
                row["track"]["scene_id"] = seen.scene.id
                yield row


def _track(frame: int, person: int, xy: np.ndarray) -> dict[str, Any]:
    x, y = np.round(xy, DECIMALS).tolist()
    return {"track": {"f": frame, "p": person, "x": x, "y": y}}


def _scene(scene: OfficialScene) -> dict[str, Any]:
    names = {"person": "p", "start": "s", "end": "e"}
    fields = {}
    for key, value in scene._asdict().items():
        fields[names.get(key, key)] = value
    return {"scene": fields}


def _lines(rows: Any) -> str:
    return "".join(f"{json.dumps(row)}\n" for row in rows)


# Forecasts of a whole test set in a file: NumPy arrays, CSV, xarray's netCDF, or
# TrajNet++ lines.
#
# The test set is forecast again; with the same seed these are the forecasts that were
# scored.

ENDINGS = (".npz", ".csv", ".nc", ".ndjson")
DIMENSIONS = {
    "samples": ("sample", "agent", "time", "xy"),
    "probabilities": ("sample", "agent"),
    "truth": ("agent", "time", "xy"),
    "observed": ("agent", "past", "xy"),
}
"""Dimensions of the arrays that have more than one value for each agent."""


def check_forecasts_file(path: Path) -> None:
    """Refuse a file name without a known ending, or a file that cannot be written.

    Raises:
        InputError: naming `path`.
    """
    if path.suffix.lower() not in ENDINGS:
        raise InputError(
            f"{path}: forecasts are written as {', '.join(ENDINGS)}, by the ending"
        )
    if path.suffix.lower() == ".nc":
        _xarray()
    refuse_unwritable(path)


def save_forecasts(
    path: Path, tests: Sequence[Test], samples: int, seed: int
) -> list[Path]:
    """Write `samples` forecasts for each model on each test set: `path`, or names beside it.

    The ending of `path`, .npz, .csv, .nc (see `to_xarray`) or .ndjson (TrajNet++), is
    the format; `seed` is the noise's. Returns the files; existing ones of the same
    name were replaced.
    """
    check_forecasts_file(path)
    is_only = sum(len(test.entries) for test in tests) == 1
    paths: list[Path] = []
    for test in tests:
        for checkpoint, model in test.entries:
            target = path if is_only else _path_beside(path, test, checkpoint, model)
            while target in paths:
                target = target.with_stem(f"{target.stem}_")
            paths.append(target)
            if path.suffix.lower() == ".ndjson":
                paths.append(write_trajnet(target, model, test, samples, seed))
            else:
                _write_arrays(target, forecasts_of(model, test, samples, seed))
    return paths


def _path_beside(path: Path, test: Test, checkpoint: str | None, model: Model) -> Path:
    """`path` with the names of a test set and of a model."""
    model_name = Path(checkpoint or model.family).name.removesuffix(".pt")
    model_name = re.sub(r"[^\w.+-]+", "_", model_name)
    kind = test.test_set
    stem = f"{path.stem}_{kind.dataset}_{kind.obs_len}_{kind.pred_len}_{model_name}"
    return path.with_name(stem + path.suffix)


def _write_arrays(path: Path, arrays: dict[str, Any]) -> None:
    """Write `forecasts_of` as .npz, .csv or .nc, by the ending."""
    for name in ("samples", "truth", "observed"):
        arrays[name] = np.round(arrays[name], DECIMALS)
    with new_file(path) as beside:
        if path.suffix.lower() == ".nc":
            to_xarray(**arrays).to_netcdf(beside, engine="scipy")
        elif path.suffix.lower() == ".csv":
            others = ("truth", "observed", "scene", "start")
            forecasts = {name: arrays[name] for name in arrays.keys() - others}
            beside.write_text(csv_of_forecasts(**forecasts), encoding="utf-8")
        else:
            np.savez_compressed(beside, **arrays)


def forecasts_of(model: Model, test: Test, samples: int, seed: int) -> dict[str, Any]:
    """Forecast a whole test set of A agent windows by `model`, in their order.

    Returns:
        World metres `samples` [k, A, pred_len, 2], `truth` [A, pred_len, 2] and
        `observed` [A, obs_len, 2]; [A] `ids`, `frames` (the last observed one: its
        number or, where the file has none, its time in seconds), `recordings`, `scene`
        and `start`, the index of the first step; `period` in seconds; and, where
        samples have them, `probabilities` [k, A].
    """
    windows = test.windows
    obs_len = windows.obs_len
    samples = model.forecaster.count(samples)
    numbers = 2.0 * samples * windows.agents * model.forecaster.pred_len
    refuse_beyond_memory("saving forecasts", 24 * numbers, "ask for fewer samples")
    with ThreadPoolExecutor(cpu_cores()) as pool:
        futures, likely = forecast_windows(
            model, windows, test.batches, samples, seed, pool.map
        )
    scene = np.repeat(np.arange(windows.scenes), windows.sizes)
    arrays = {
        "samples": futures,
        "truth": windows.position[:, obs_len:],
        "observed": windows.position[:, :obs_len],
        "scene": scene,
        "ids": windows.agent,
        "frames": last_frames(windows)[scene],
        "recordings": recording_names(windows)[scene],
        "start": windows.identity[scene, 1].astype(np.int64),
        "period": windows.period,
    }
    if likely is not None:
        arrays["probabilities"] = likely[:, scene]
    return arrays


def to_xarray(samples: ArrayLike, *, period: float = 0.4, **arrays: ArrayLike) -> Any:
    """Forecasts of A people as an `xarray.Dataset`, with `time` in seconds from the last position.

    `to_xarray(nj.predict(...))` takes a scene's, `to_xarray(**forecasts_of(...))` a
    test set's.

    Args:
        samples: [k, A, T, 2] metres.
        period: seconds between steps.
        **arrays: `probabilities` [k] or [k, A], `truth` [A, T, 2], `observed` [A,
            obs_len, 2], and coordinates [A] by any other name, such as `ids`.

    Raises:
        InputError: where xarray is not installed.
    """
    variables: dict[str, Any] = {}
    for name, values in {"samples": samples, **arrays}.items():
        values = np.asarray(values)
        dimensions = DIMENSIONS.get(name, ("agent",))
        variables[name] = (dimensions[: values.ndim], values)
    variables["xy"] = ["x", "y"]
    steps = np.shape(samples)[2]
    variables["time"] = period * np.arange(1, steps + 1)
    if "observed" in arrays:
        obs_len = np.shape(arrays["observed"])[1]
        variables["past"] = period * np.arange(1 - obs_len, 1)
    attributes = {"units": "metres", "period": period}
    dataset = _xarray().Dataset(variables, attrs=attributes)
    return dataset.set_coords(arrays.keys() - DIMENSIONS.keys())


def _xarray() -> Any:
    return optional_module("xarray", "a .nc file", "frames")
