"""Forecasts of a whole test set in a file: NumPy arrays, or TrajNet++ lines (docs/evaluate.md).

The test set is forecast again; with the same seed these are the forecasts that were scored.
"""

import json
import re
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import NamedTuple

import numpy as np

from neurosym_jax.errors import InputError
from neurosym_jax.evaluation.test_sets import Test
from neurosym_jax.forecasting.batched import forecast_windows
from neurosym_jax.forecasting.model import Model
from neurosym_jax.runtime.environment import cpu_cores
from neurosym_jax.runtime.files import new_file, refuse_unwritable
from neurosym_jax.runtime.memory import refuse_beyond_memory
from neurosym_jax.scene import scene_identity

__all__ = ["Forecasts", "check_forecasts_file", "forecasts_of", "save_forecasts"]

DECIMALS = 4
"""Decimals of metres in files."""


class Forecasts(NamedTuple):
    """Forecasts of the A agent windows of a test set; positions are world metres."""

    forecast: np.ndarray
    """[k, A, pred_len, 2]."""
    truth: np.ndarray
    """[A, pred_len, 2]."""
    observed: np.ndarray
    """[A, obs_len, 2]."""
    scene: np.ndarray
    """[A] index of the scene in the test set."""
    person: np.ndarray
    """[A] id in the recording."""
    recording: np.ndarray
    """[A] name."""
    start: np.ndarray
    """[A] index of the first observed step in the recording."""
    period: float
    """Seconds between steps."""
    probability: np.ndarray | None
    """[k, A] of each sample, the same for all of a scene; None where all samples have the same."""


def check_forecasts_file(path: Path) -> None:
    """Refuse a file name without a known ending, or a file that cannot be written.

    Raises:
        InputError: naming `path`.
    """
    if path.suffix.lower() not in WRITERS:
        raise InputError(f"{path}: forecasts are written as {', '.join(WRITERS)}, by the ending")
    refuse_unwritable(path)


def save_forecasts(path: Path, tests: Sequence[Test], samples: int, seed: int) -> list[Path]:
    """Write a file for each model on each test set: `path`, or several names beside it.

    Args:
        path: its ending, .npz or .ndjson (TrajNet++), is the format.
        tests: test sets and their models.
        samples: k.
        seed: random seed of the noise.

    Returns:
        The files; existing ones of the same name were replaced.

    Raises:
        InputError: see `check_forecasts_file`.
    """
    check_forecasts_file(path)
    entries = [(test, *entry) for test in tests for entry in test.entries]
    paths: list[Path] = []
    for test, checkpoint, model in entries:
        name = Path(checkpoint or model.kind).name.removesuffix(".pt")
        parts = [path.stem, test.test_set.dataset, test.test_set.obs_len, test.test_set.pred_len]
        stem = "_".join(map(str, [*parts, re.sub(r"[^\w.+-]+", "_", name)]))
        target = path.with_name(stem + path.suffix) if len(entries) > 1 else path
        while target in paths:
            target = target.with_stem(f"{target.stem}_")
        with new_file(target) as beside:
            WRITERS[path.suffix.lower()](beside, forecasts_of(model, test, samples, seed))
        paths.append(target)
    return paths


def forecasts_of(model: Model, test: Test, samples: int, seed: int) -> Forecasts:
    """Forecast a whole test set by `model`, in the order of its windows."""
    windows, obs_len, forecaster = test.windows, test.windows.obs_len, model.forecaster
    samples = forecaster.count(samples)
    numbers = 2.0 * samples * windows.agents * forecaster.pred_len
    refuse_beyond_memory("saving forecasts", 24 * numbers, "ask for fewer samples")
    with ThreadPoolExecutor(cpu_cores()) as pool:
        found, likely = forecast_windows(model, windows, test.batches, samples, seed, pool.map)
    scene = np.repeat(np.arange(windows.scenes), windows.sizes)
    names = {int(scene_identity(how.recording, 0)[0]): how.recording for how in windows.reading}
    recording = np.array([names[int(digest)] for digest in windows.identity[:, 0]])
    truth, observed = windows.position[:, obs_len:], windows.position[:, :obs_len]
    start = windows.identity[scene, 1].astype(np.int64)
    who = (scene, windows.agent, recording[scene], start)
    likely = None if likely is None else likely[:, scene]
    return Forecasts(found, truth, observed, *who, windows.period, likely)


def _write_npz(path: Path, forecasts: Forecasts) -> None:
    arrays = {name: value for name, value in forecasts._asdict().items() if value is not None}
    for name in ("forecast", "truth", "observed"):
        arrays[name] = np.round(arrays[name], DECIMALS)
    np.savez_compressed(path, **arrays)


def _write_trajnet(path: Path, forecasts: Forecasts) -> None:
    with path.open("w", encoding="utf-8") as file:
        for kind, fields in _trajnet_rows(forecasts):
            file.write(json.dumps({kind: fields}) + "\n")


def _trajnet_rows(forecasts: Forecasts) -> Iterator[tuple[str, dict[str, object]]]:
    """Rows of TrajNet++: scenes, tracks, forecasts. The file is one recording, so frames and people
    of several recordings are numbered consecutively."""
    obs_len = forecasts.observed.shape[1]
    steps = obs_len + forecasts.truth.shape[1]
    first, begin = forecasts.start.copy(), 0
    for name in dict.fromkeys(forecasts.recording):
        of = forecasts.recording == name
        first[of] += begin
        begin = int(first[of].max()) + steps
    who = list(zip(forecasts.recording.tolist(), forecasts.person.tolist()))
    number = {person: at for at, person in enumerate(dict.fromkeys(who))}
    people = [number[person] for person in who]
    for scene, agent in zip(*np.unique(forecasts.scene, return_index=True)):
        at = int(first[agent])
        ends = {"s": at, "e": at + steps - 1, "fps": round(1 / forecasts.period, 6)}
        yield "scene", {"id": int(scene), "p": people[agent], **ends}

    def tracks(agent: int, path: np.ndarray, begin: int) -> Iterator[dict[str, object]]:
        for frame, (x, y) in enumerate(np.round(path, DECIMALS).tolist(), begin):
            yield {"f": frame, "p": people[agent], "x": x, "y": y}

    told = set()
    happened = np.concatenate([forecasts.observed, forecasts.truth], axis=1)
    for agent, path in enumerate(happened):
        for track in tracks(agent, path, int(first[agent])):
            if (track["f"], track["p"]) not in told:
                told.add((track["f"], track["p"]))
                yield "track", track
    for agent in range(len(people)):
        of = {"scene_id": int(forecasts.scene[agent])}
        paths = forecasts.forecast[:, agent]
        if forecasts.probability is not None:  # The evaluator takes number 0 for the best guess.
            paths = paths[np.argsort(-forecasts.probability[:, agent], kind="stable")]
        for sample, path in enumerate(paths):
            for track in tracks(agent, path, int(first[agent]) + obs_len):
                yield "track", {**track, "prediction_number": sample, **of}


WRITERS: dict[str, Callable[[Path, Forecasts], None]] = {
    ".npz": _write_npz,
    ".ndjson": _write_trajnet,
}
