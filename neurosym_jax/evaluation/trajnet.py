"""Forecasts as TrajNet++ files, with the frames, people, scenes and tags of the recording.

TrajNet++'s evaluator reads two files, what happened and what was forecast. It counts
the forecast of each scene's primary person, and its collisions (Col-I) where every
neighbour is forecast who was seen at any observed step. So the scenes that a TrajNet++
recording lists are forecast for all of these; steps at which they were not seen are
filled at constant velocity. Other recordings have a scene for each window, whose people
are there throughout.
"""

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from neurosym_jax.data.readers.trajnet import OfficialScene, Trajnet, read_scenes
from neurosym_jax.data.tables import AS_IT_SAYS
from neurosym_jax.data.tracks import PERIOD
from neurosym_jax.data.windows import Windows, make_batches
from neurosym_jax.errors import InputError
from neurosym_jax.evaluation.forecasts import last_frames, recording_names
from neurosym_jax.evaluation.plan import Test
from neurosym_jax.forecasting.batched import forecast_windows
from neurosym_jax.forecasting.model import Model
from neurosym_jax.runtime.files import new_file
from neurosym_jax.scene import scene_identity

__all__ = ["DECIMALS", "write_trajnet"]

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
    listed = [seen.scene for seen in scenes]
    with new_file(truth) as beside:
        rows = (
            _track(frame, person, xy) for (frame, person), xy in sorted(points.items())
        )
        beside.write_text(_lines(map(_scene, listed)) + _lines(rows), encoding="utf-8")
    with new_file(target) as beside, beside.open("w", encoding="utf-8") as file:
        file.write(_lines(map(_scene, listed)))
        for seen, futures in _forecasts(model, test, scenes, samples, seed):
            file.write(_lines(_predictions(seen, futures)))
    return truth


def _official(test: Test) -> tuple[Points, list[ObservedScene]] | None:
    """The points and the scenes of a TrajNet++ recording; None where the test set is another."""
    windows = test.windows
    (reading, *others) = windows.reading
    if others or reading.format != "trajnet" or not reading.file:
        return None
    listed = read_scenes(path := Path(reading.file))
    if not listed or abs(windows.period - 1 / listed[0].fps) > 0.01 * windows.period:
        return None
    (tracks,) = Trajnet().read(path, AS_IT_SAYS, PERIOD)
    frames = np.rint(tracks.stamp * (reading.rate or 1)).astype(int)
    points = {
        (frame, person): xy
        for frame, person, xy in zip(
            frames.tolist(), tracks.id.tolist(), tracks.position
        )
    }
    step = round(windows.period * (reading.rate or 1))
    people_at: dict[int, list[int]] = {}
    for frame, person in points:
        people_at.setdefault(frame, []).append(person)
    obs_len, pred_len = test.test_set.obs_len, test.test_set.pred_len
    scenes = []
    for scene in listed:
        steps = np.arange(scene.start, scene.end + 1, step)
        past, future = steps[:-pred_len], steps[-pred_len:]
        if len(past) < obs_len:
            raise InputError(
                f"{path}: scene {scene.id} has {len(steps)} steps, not {obs_len} + {pred_len}"
            )
        seen = {
            person for frame in past.tolist() for person in people_at.get(frame, ())
        }
        people = [scene.person, *sorted(seen - {scene.person})]
        nothing = np.full(2, np.nan)
        walks = [
            [points.get((frame, person), nothing) for frame in past.tolist()]
            for person in people
        ]
        observed = np.stack([_filled(np.array(walk))[-obs_len:] for walk in walks])
        scenes.append(ObservedScene(scene, np.array(people), observed, future))
    return points, scenes


def _filled(path: np.ndarray) -> np.ndarray:
    """A path [T, 2] with NaN rows interpolated or, at the ends, walked on at constant velocity.

    Raises:
        InputError: for a path without a point.
    """
    steps, (seen,) = np.arange(len(path)), np.nonzero(np.isfinite(path[:, 0]))
    if not len(seen):
        raise InputError("a scene's primary person is not seen at any observed step")
    filled = np.stack(
        [np.interp(steps, seen, path[seen, axis]) for axis in range(2)], axis=1
    )
    if len(seen) > 1:
        for end, inner in ((seen[0], seen[1]), (seen[-1], seen[-2])):
            velocity = (path[end] - path[inner]) / (end - inner)
            outside = steps < end if end < inner else steps > end
            filled[outside] += velocity * (steps[outside, None] - end)
    return filled


def _of_windows(test: Test) -> tuple[Points, list[ObservedScene]]:
    """The points and a scene for each window. Of several recordings, frames and people are numbered
    consecutively, because a file is one recording."""
    windows = test.windows
    names, steps = recording_names(windows), windows.position.shape[1]
    rate = windows.reading[0].rate if len(windows.reading) == 1 else None
    renumbered = rate is None
    last = windows.identity[:, 1].astype(int) + windows.obs_len - 1
    last = last if renumbered else np.rint(last_frames(windows)).astype(int)
    stride, shift, numbers = 1 if renumbered else round(rate * windows.period), 0, {}
    points: Points = {}
    scenes = []
    for name in dict.fromkeys(names.tolist()):
        members = np.flatnonzero(names == name)
        for at in members:
            rows = slice(*windows.bounds[at : at + 2])
            frames = last[at] + shift + stride * np.arange(1 - windows.obs_len, 1)
            future = frames[-1] + stride * np.arange(1, steps - windows.obs_len + 1)
            people = windows.agent[rows]
            if renumbered:
                keys = ((name, person) for person in people.tolist())
                people = np.array(
                    [numbers.setdefault(key, len(numbers)) for key in keys]
                )
            for person, path in zip(people.tolist(), windows.position[rows]):
                points |= {
                    (frame, person): xy
                    for frame, xy in zip([*frames.tolist(), *future.tolist()], path)
                }
            ends = int(frames[0]), int(future[-1])
            fps, tag = round(1 / windows.period, 6), [0, []]
            scene = OfficialScene(int(at), int(people[0]), *ends, fps, tag)
            observed = windows.position[rows, : windows.obs_len]
            scenes.append(ObservedScene(scene, people, observed, future))
        shift = max(frame for frame, _ in points) + 1 if renumbered else 0
    return points, scenes


def _forecasts(
    model: Model, test: Test, scenes: list[ObservedScene], samples: int, seed: int
) -> Iterator[tuple[ObservedScene, np.ndarray]]:
    """Each scene and [k, N, T, 2] metres, its most probable sample first.

    The noise is that of the windows where the scenes are these.
    """
    bounds = np.cumsum([0, *(len(seen.people) for seen in scenes)])
    name = test.windows.reading[0].recording
    own = len(scenes) == test.windows.scenes and (bounds == test.windows.bounds).all()
    starts = np.array([seen.scene.id for seen in scenes])
    windows = Windows(
        np.concatenate([seen.observed for seen in scenes]),
        np.concatenate([seen.people for seen in scenes]),
        bounds,
        test.windows.identity if own else scene_identity(name, starts),
        test.test_set.obs_len,
        test.windows.period,
    )
    futures, likely = forecast_windows(
        model, windows, make_batches(windows), samples, seed
    )
    for number, seen in enumerate(scenes):
        own_samples = futures[:, slice(*bounds[number : number + 2])]
        if likely is not None:  # The evaluator takes number 0 for the best guess.
            own_samples = own_samples[np.argsort(-likely[:, number], kind="stable")]
        yield seen, own_samples


def _predictions(seen: ObservedScene, samples: np.ndarray) -> Iterator[dict[str, Any]]:
    for number, sample in enumerate(samples):
        for person, path in zip(seen.people.tolist(), sample):
            for frame, xy in zip(seen.frames.tolist(), path):
                row = _track(frame, person, xy)
                row["track"] |= {"prediction_number": number, "scene_id": seen.scene.id}
                yield row


def _track(frame: int, person: int, xy: np.ndarray) -> dict[str, Any]:
    x, y = np.round(xy, DECIMALS).tolist()
    return {"track": {"f": frame, "p": person, "x": x, "y": y}}


def _scene(scene: OfficialScene) -> dict[str, Any]:
    names = {"person": "p", "start": "s", "end": "e"}
    return {
        "scene": {names.get(key, key): value for key, value in scene._asdict().items()}
    }


def _lines(rows: Any) -> str:
    return "".join(f"{json.dumps(row)}\n" for row in rows)
