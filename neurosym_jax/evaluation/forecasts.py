"""Forecasts of a test set in files: read, and matched to its windows.

A file has a row for each person of each window: the forecast, the person's id and the
frame of the last observed position. Rows are matched to the test set's windows by
recording, frame and id.
"""

import dataclasses
import warnings
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl

from neurosym_jax.data.readers.trajnet import read_predictions
from neurosym_jax.data.tracks import Reading
from neurosym_jax.data.windows import Windows
from neurosym_jax.errors import InputError, InputWarning
from neurosym_jax.evaluation.tables import csv_text, unique_suffixes
from neurosym_jax.runtime.foreign import read_arrays, reading
from neurosym_jax.scene import scene_identity

__all__ = [
    "ForecastFile",
    "Forecasts",
    "csv_of_forecasts",
    "last_frames",
    "match",
    "matched",
    "read_csv_forecasts",
    "read_forecasts",
    "read_named",
    "recording_names",
    "windows_of",
]


JUMP = 5.0
"""Speed to the first forecast position, m/s, that no test set's median reaches."""
SHIFT = 0.05
"""Metres of error at the first step above which a shift by one step can be told."""
KINDS = ".npz, .csv or .ndjson"
NEEDED = ("samples", "ids", "frames")
"""Arrays that a file must have."""
KINDS_OF = {"recordings": "US", "ids": "iufU"}
"""Kinds of numpy's types of arrays that may be texts."""


@dataclasses.dataclass(frozen=True, eq=False)
class Forecasts:
    """Samples for all A agents of a test set's S windows, in their order."""

    name: str
    """Of the predictor, in tables."""
    samples: np.ndarray
    """[k, A, T, 2] float64 world metres."""
    probability: np.ndarray | None = None
    """[k, S]; None where all are the same."""
    latency: float | None = None
    """Median seconds to forecast a scene, where it was forecast here."""


@dataclasses.dataclass(frozen=True, eq=False)
class ForecastFile:
    """Forecasts as a file has them: A rows in any order."""

    path: Path
    samples: np.ndarray
    """[k, A, T, 2] float64 metres, in the recording's frame."""
    ids: np.ndarray
    """[A] person, as the recording has them: whole numbers or texts."""
    frames: np.ndarray
    """[A] number of the last observed frame; its time in seconds where frames have no number."""
    recordings: np.ndarray | None = None
    """[A] names; None where the file is of one recording."""
    probabilities: np.ndarray | None = None
    """[k, A]; None where all samples are equally probable."""
    truth: Mapping[str, np.ndarray] = dataclasses.field(default_factory=dict)
    """What happened, where the file has it: `observed` [A, obs_len, 2], `truth` [A, T, 2], `scene`
    [A], `start` [A] and `period`, as `save_forecasts` writes them."""

    @property
    def steps(self) -> int:
        """T, the steps of each forecast."""
        return self.samples.shape[2]


def read_named(files: Any) -> dict[str, ForecastFile]:
    """Read a file, several, or files by name; others are called by their shortest unique end."""
    if isinstance(files, str | Path):
        files = [files]
    if not isinstance(files, Mapping):
        paths = [Path(path) for path in files]
        stems = [path.with_suffix("") for path in paths]
        if len(set(stems)) < len(set(paths)):
            stems = paths  # They differ in their ending alone.
        files = dict(zip(unique_suffixes(stems), paths))
    return {name: read_forecasts(Path(path)) for name, path in files.items()}


def read_forecasts(path: Path) -> ForecastFile:
    """Read forecasts from `.npz` or `.csv` (see docs/evaluate.md), or TrajNet++'s `.ndjson`.

    Raises:
        InputError: naming the file and what is wrong.
    """
    with reading(path, KINDS):
        if path.suffix.lower() == ".ndjson":
            return ForecastFile(path, *read_predictions(path))
        if path.suffix.lower() == ".csv":
            return _checked(path, read_csv_forecasts(path))
        return _checked(path, read_arrays(path, KINDS))


def _checked(path: Path, arrays: dict[str, np.ndarray]) -> ForecastFile:
    """The forecasts of these arrays, which may be anything."""
    missing = [name for name in NEEDED if name not in arrays]
    if missing:
        names = ", ".join(sorted(arrays)[:12]) or "none"
        raise InputError(
            f"{path}: array {missing[0]!r} is missing (its arrays: {names})"
        )
    samples = arrays["samples"]
    agents = samples.shape[1] if samples.ndim == 4 else 0
    shapes = {"samples": (*samples.shape[:3], 2)}
    for name in ("ids", "frames", "recordings"):
        if name in arrays:
            shapes[name] = (agents,)
    likely = arrays.get("probabilities")
    if likely is not None:
        if likely.ndim == 1:
            likely = likely[:, None]
        likely = np.broadcast_to(likely, (len(likely), agents))
        arrays["probabilities"] = likely
        shapes["probabilities"] = (len(samples), agents)
    for name, shape in shapes.items():
        array = arrays[name]
        is_kind = array.dtype.kind in KINDS_OF.get(name, "iuf")
        if not agents or array.shape != shape or not is_kind:
            layout = "[k, A, T, 2]" if name == "samples" else list(shape)
            shape_text = f"{list(array.shape)} {array.dtype}"
            raise InputError(f"{path}: {name} must be {layout}, not {shape_text}")
    is_finite = np.isfinite(samples).all(axis=(0, 2, 3))
    wrong = int(np.sum(~is_finite))
    if wrong:
        raise InputError(f"{path}: samples of {wrong} of {agents} rows are not finite")
    if likely is not None:
        has_sum = np.allclose(likely.sum(axis=0), 1, atol=1e-3)
        if not has_sum or (likely < 0).any():
            raise InputError(
                f"{path}: probabilities must not be negative and have a sum of 1"
            )
    fields: dict[str, Any] = {}
    for name in (*NEEDED, "recordings", "probabilities"):
        fields[name] = arrays.pop(name, None)
    return ForecastFile(path, **fields, truth=arrays)


def windows_of(file: ForecastFile) -> Windows:
    """The windows that a file itself holds, with what happened in them.

    Raises:
        InputError: for a file without them.
    """
    names = ("observed", "truth", "scene", "start", "period")
    missing = [name for name in names if name not in file.truth]
    if missing:
        raise InputError(
            f"{file.path}: does not hold what happened ({missing[0]!r}): name the recordings that "
            "were forecast"
        )
    with reading(file.path, "forecasts with what happened"):
        arrays = [np.asarray(file.truth[name]) for name in names]
        observed, truth, scene, start, period = arrays
        order = np.argsort(scene, kind="stable")
        first = np.unique(scene[order], return_index=True)[1]
        recordings = np.array(_recordings(file))[order]
        digests = [scene_identity(name, 0)[0] for name in recordings[first]]
        position = np.concatenate([observed, truth], axis=1).astype(np.float64)
        identity = np.stack([digests, start[order][first]], axis=-1)
        return Windows(
            position=position[order],
            agent=_whole(file.ids[order]),
            bounds=np.append(first, len(scene)),
            identity=identity.astype(np.uint32),
            obs_len=observed.shape[1],
            period=float(period),
            reading=tuple(map(Reading, dict.fromkeys(recordings.tolist()))),
            stamp=file.frames[order][first].astype(np.float64),
        )


def _whole(ids: np.ndarray) -> np.ndarray:
    """[A] ids: texts as they are, numbers without fractions."""
    return ids if ids.dtype.kind == "U" else ids.astype(np.int64)


def _recordings(file: ForecastFile, windows: Windows | None = None) -> list[str]:
    """[A] names of recordings; that of `windows` where the file has none."""
    if file.recordings is not None:
        return np.asarray(file.recordings).astype(str).tolist()
    return [recording_names(windows)[0] if windows else ""] * len(file.ids)


def recording_names(windows: Windows) -> np.ndarray:
    """[S] names of the recordings of scenes."""
    return np.array([reading.recording for reading in _readings(windows)])


def last_frames(windows: Windows) -> np.ndarray:
    """[S] numbers of the last observed frames, or seconds where the file does not number frames."""
    stamps = np.zeros(windows.scenes) if windows.stamp is None else windows.stamp
    rates = [reading.rate or 1.0 for reading in _readings(windows)]
    return np.round(stamps * rates, 3)


def _readings(windows: Windows) -> list[Reading]:
    """[S] how the recordings of scenes were read."""
    readings = {
        int(scene_identity(reading.recording, 0)[0]): reading
        for reading in windows.reading
    }
    return [readings[int(digest)] for digest in windows.identity[:, 0]]


def match(
    file: ForecastFile, windows: Windows, *, partial: bool = False
) -> tuple[np.ndarray, np.ndarray]:
    """Match the rows of a file to windows by recording, frame and id.

    Args:
        file: see `read_forecasts`.
        windows: of the test set.
        partial: leave out windows of which not all people have a forecast, and
            forecasts without a window; else both are refused.

    Returns:
        [S] bool, windows that have forecasts, and [A] the row of each agent window, -1
        for none.

    Raises:
        InputError: with counts, for what does not match.
    """
    with reading(file.path, "forecasts of these windows"):
        return _match(file, windows, partial)


def _match(
    file: ForecastFile, windows: Windows, partial: bool
) -> tuple[np.ndarray, np.ndarray]:
    """See `match`, whose door stands around this."""
    names = _recordings(file, windows)
    own = recording_names(windows)
    if file.recordings is None and len(set(own)) > 1:
        raise InputError(
            f"{file.path}: has no `recordings`, and the test set has {len(set(own))}"
        )
    ids, people = file.ids, windows.agent
    if "U" in (ids.dtype.kind, people.dtype.kind):
        ids, people = _whole(ids).astype(str), people.astype(str)
    file_frames = np.round(file.frames, 3).tolist()
    keys = zip(names, file_frames, ids.tolist())
    rows = {key: row for row, key in enumerate(keys)}
    twice = len(ids) - len(rows)
    if twice:
        raise InputError(f"{file.path}: {twice} rows repeat a recording, frame and id")
    scene = np.repeat(np.arange(windows.scenes), windows.sizes)
    frames = last_frames(windows)
    own_keys = zip(own[scene], frames[scene].tolist(), people.tolist())
    matches = np.array([rows.get(key, -1) for key in own_keys])
    complete = np.ones(windows.scenes, bool)
    complete[scene[matches < 0]] = False
    used = np.unique(matches[matches >= 0])
    missing = np.sum(matches < 0)
    unused = np.isin(names, own).sum() - len(used)
    if not complete.any() or ((missing or unused) and not partial):
        hint = ""
        truth = file.path.with_stem(f"{file.path.stem}_truth")
        if truth.is_file():
            hint = f"; they were saved with the recording {truth}"
        raise InputError(
            f"{file.path}: {missing} of {windows.agents} people in windows have no forecast, and "
            f"{unused} of {len(file.ids)} forecasts are of none of these (matched by frame and id; "
            f"the windows begin with frame {frames[0]:g}, id {windows.agent[0]}, the file with "
            f"{file.frames[0]:g}, {file.ids[0]}){hint}"
        )
    _check_fit(file, windows, matches)
    return complete, matches


def _check_fit(file: ForecastFile, windows: Windows, rows: np.ndarray) -> None:
    """Refuse forecasts that begin elsewhere; warn of another step. `rows [A]` as in `match`."""

    def median(step: int, position: int) -> float:
        """Metres from a forecast step to an observed or true one; of people, of the best sample."""
        has_row = rows >= 0
        places = file.samples[:, rows[has_row], step]
        offset = places - windows.position[has_row, position]
        distance = np.linalg.norm(offset, axis=-1)
        return float(np.median(distance.min(axis=0)))

    present = windows.obs_len - 1
    jump = median(0, present)
    if jump > JUMP * windows.period + 1:
        raise InputError(
            f"{file.path}: forecasts begin {jump:.1f} m from people's last positions in the "
            "median: another recording, unit or frame of reference"
        )
    if file.steps > 1:
        aligned = median(0, present + 1)
        for words, other in (
            ("later", (0, present + 2)),
            ("earlier", (1, present + 1)),
        ):
            shifted = median(*other)
            if shifted < 0.7 * aligned and aligned > SHIFT:
                line = (
                    f"{file.path}: forecasts fit what happened a step {words}, {shifted:.2f} m off "
                    f"and not {aligned:.2f} m: are `frames` those of the last observed positions?"
                )
                warnings.warn(line, InputWarning, stacklevel=2)


def matched(
    file: ForecastFile, name: str, windows: Windows, rows: np.ndarray
) -> Forecasts:
    """The rows [A] of a file as forecasts of `windows`.

    Raises:
        InputError: where people of one scene have other probabilities.
    """
    samples = np.asarray(file.samples, np.float64)[:, rows]
    if file.probabilities is None:
        return Forecasts(name, samples)
    likely = np.asarray(file.probabilities, np.float64)[:, rows]
    first = windows.bounds[:-1]
    shared = np.repeat(likely[:, first], windows.sizes, axis=1)
    difference = np.abs(likely - shared).max(axis=0)
    wrong = int(np.sum(difference > 1e-6))
    if wrong:
        raise InputError(
            f"{file.path}: probabilities of {wrong} people are not those of others in their scene: "
            "a sample is one future of all of them (leave `probabilities` out)"
        )
    return Forecasts(name, samples, likely[:, first])


# Forecasts as CSV: a row for each step of each sample of each person.
#
# Columns are recording, frame (the last observed one), id, sample (from 0), step (from
# 1), seconds (from the last observed position), x and y in metres, and the probability
# of the sample where samples have one. Of a file to be read, recording, sample, seconds
# and probability may be absent.

COLUMNS = ("frame", "id", "step", "x", "y")
PERSON = ("recording", "frame", "id")
"""Columns that tell forecasts of a file apart."""
FORMULA = r"^'([=+@]|-\p{L})"
"""A text that `csv_text` keeps spreadsheets from calculating."""


def csv_of_forecasts(
    samples: np.ndarray,
    ids: np.ndarray,
    frames: np.ndarray,
    recordings: np.ndarray,
    period: float,
    probabilities: np.ndarray | None = None,
) -> str:
    """The text of a file.

    Args:
        samples: [k, A, T, 2] metres.
        ids: [A].
        frames: [A], of the last observed position.
        recordings: [A] names.
        period: seconds between steps.
        probabilities: [k, A], if the samples have them.
    """
    count, people, steps, _ = samples.shape
    person, sample, step = np.indices((people, count, steps)).reshape(3, -1)
    x, y = samples[sample, person, step].T
    columns = {
        "recording": recordings[person],
        "frame": frames[person],
        "id": ids[person],
        "sample": sample,
        "step": step + 1,
        "seconds": np.round(period * (step + 1), 6),
        "x": x,
        "y": y,
    }
    if (frames == np.rint(frames)).all():
        columns["frame"] = columns["frame"].astype(np.int64)
    if probabilities is not None:
        columns["probability"] = probabilities[sample, person].round(6)
    return csv_text(pl.DataFrame(columns))


def read_csv_forecasts(path: Path) -> dict[str, np.ndarray]:
    """The arrays `samples`, `ids`, `frames` and, where the file has them, `recordings` and
    `probabilities`, as an `.npz` has them.

    Raises:
        InputError: for columns that are missing, a file without rows, steps that are not
            1, 2, ..., people who have not each step of each sample once, and
            probabilities that change within a sample.
    """
    table, steps = _table(path)
    if "sample" not in table.columns:
        table = table.with_columns(sample=pl.lit(0))
    table = table.with_columns(pl.col(pl.String).str.replace(FORMULA, "$1"))
    key = [name for name in PERSON if name in table.columns]
    people = table.select(key).unique(maintain_order=True)
    count = table["sample"].n_unique()

    once = table.select(*key, "sample", "step").n_unique() == len(table)
    if not once or len(table) != count * len(people) * steps:
        raise InputError(
            f"{path}: {len(table)} rows, not each of {steps} steps of {count} samples of "
            f"{len(people)} people once"
        )
    number = people.with_row_index("person")
    order = ("person", "sample", "step")
    table = table.join(number, on=key, nulls_equal=True).sort(order)
    shape = (len(people), count, steps)
    values = {}
    for name in ("x", "y", *({"probability"} & set(table.columns))):
        values[name] = table[name].cast(pl.Float64).to_numpy().reshape(shape)
    points = np.stack([values["x"], values["y"]], axis=-1)
    arrays: dict[str, Any] = {
        "samples": points.swapaxes(0, 1),
        "ids": _texts_or_numbers(people["id"]),
        "frames": people["frame"].cast(pl.Float64).to_numpy(),
    }
    if "recording" in key:
        arrays["recordings"] = (
            people["recording"].cast(pl.String).to_numpy().astype("U")
        )
    if "probability" in values:
        likely = values["probability"]
        if (np.ptp(likely, axis=-1) > 1e-6).any():
            raise InputError(
                f"{path}: the probability of a sample differs between steps"
            )
        arrays["probabilities"] = likely[..., 0].T
    return arrays


def _table(path: Path) -> tuple[pl.DataFrame, int]:
    """The rows of a file, and the number of its steps."""
    table = pl.read_csv(path, infer_schema_length=None)
    missing = [name for name in COLUMNS if name not in table.columns]
    if missing:
        raise InputError(
            f"{path}: column {missing[0]!r} is missing (its columns: "
            f"{', '.join(table.columns[:12])})"
        )
    if not len(table):
        raise InputError(f"{path}: has no rows")
    numbers = table["step"].unique().sort().to_list()
    if numbers != list(range(1, len(numbers) + 1)):
        listed = ", ".join(map(str, numbers[:12]))
        raise InputError(
            f"{path}: steps must be 1, 2, ..., the first after the last observed one, "
            f"not {listed}"
        )
    return table, len(numbers)


def _texts_or_numbers(ids: pl.Series) -> np.ndarray:
    """[A] ids, as the file has them."""
    if ids.dtype == pl.String:
        return ids.to_numpy().astype("U")
    return ids.to_numpy()
