"""Forecasts of a whole test set in a file: NumPy arrays, xarray's netCDF, or TrajNet++ lines.

The test set is forecast again; with the same seed these are the forecasts that were scored.
"""

import re
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
from numpy.typing import ArrayLike

from neurosym_jax.errors import InputError
from neurosym_jax.evaluation.plan import Test
from neurosym_jax.forecasting.batched import forecast_windows
from neurosym_jax.forecasting.model import Model
from neurosym_jax.runtime.files import new_file, refuse_unwritable
from neurosym_jax.runtime.process import cpu_cores, refuse_beyond_memory
from neurosym_jax.scene import scene_identity

__all__ = ["check_forecasts_file", "forecasts_of", "save_forecasts", "to_xarray"]

DECIMALS = 4
"""Decimals of metres in files."""
ENDINGS = (".npz", ".nc", ".ndjson")
DIMENSIONS = {
    "forecast": ("sample", "agent", "time", "xy"),
    "probability": ("sample", "agent"),
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
        raise InputError(f"{path}: forecasts are written as {', '.join(ENDINGS)}, by the ending")
    if path.suffix.lower() == ".nc":
        _xarray()
    refuse_unwritable(path)


def save_forecasts(path: Path, tests: Sequence[Test], samples: int, seed: int) -> list[Path]:
    """Write `samples` forecasts for each model on each test set: `path`, or names beside it.

    The ending of `path`, .npz, .nc (see `to_xarray`) or .ndjson (TrajNet++), is the format; `seed`
    is the noise's. Returns the files; existing ones of the same name were replaced.
    """
    check_forecasts_file(path)
    entries = [(test, *entry) for test in tests for entry in test.entries]
    paths: list[Path] = []
    for test, checkpoint, model in entries:
        name = Path(checkpoint or model.family).name.removesuffix(".pt")
        parts = [path.stem, test.test_set.dataset, test.test_set.obs_len, test.test_set.pred_len]
        stem = "_".join(map(str, [*parts, re.sub(r"[^\w.+-]+", "_", name)]))
        target = path.with_name(stem + path.suffix) if len(entries) > 1 else path
        while target in paths:
            target = target.with_stem(f"{target.stem}_")
        found = forecasts_of(model, test, samples, seed)
        for each in ("forecast", "truth", "observed"):
            found[each] = np.round(found[each], DECIMALS)
        with new_file(target) as beside:
            if path.suffix.lower() == ".ndjson":
                beside.write_text(_trajnet_text(found), encoding="utf-8")
            elif path.suffix.lower() == ".nc":
                to_xarray(**found).to_netcdf(beside, engine="scipy")
            else:
                np.savez_compressed(beside, **found)
        paths.append(target)
    return paths


def forecasts_of(model: Model, test: Test, samples: int, seed: int) -> dict[str, Any]:
    """Forecast a whole test set of A agent windows by `model`, in their order.

    Returns:
        World metres `forecast` [k, A, pred_len, 2], `truth` [A, pred_len, 2] and `observed`
        [A, obs_len, 2]; [A] `scene`, `person`, `recording` and `start`, the index of the first
        step; `period` in seconds; and, where samples have it, `probability` [k, A].
    """
    windows, obs_len, forecaster = test.windows, test.windows.obs_len, model.forecaster
    samples = forecaster.count(samples)
    numbers = 2.0 * samples * windows.agents * forecaster.pred_len
    refuse_beyond_memory("saving forecasts", 24 * numbers, "ask for fewer samples")
    with ThreadPoolExecutor(cpu_cores()) as pool:
        found, likely = forecast_windows(model, windows, test.batches, samples, seed, pool.map)
    scene = np.repeat(np.arange(windows.scenes), windows.sizes)
    names = {int(scene_identity(how.recording, 0)[0]): how.recording for how in windows.reading}
    recording = np.array([names[int(digest)] for digest in windows.identity[:, 0]])
    return {
        "forecast": found,
        "truth": windows.position[:, obs_len:],
        "observed": windows.position[:, :obs_len],
        "scene": scene,
        "person": windows.agent,
        "recording": recording[scene],
        "start": windows.identity[scene, 1].astype(np.int64),
        "period": windows.period,
        **({} if likely is None else {"probability": likely[:, scene]}),
    }


def to_xarray(forecast: ArrayLike, *, period: float = 0.4, **arrays: ArrayLike) -> Any:
    """Forecasts of A people as an `xarray.Dataset`, with `time` in seconds from the last position.

    `to_xarray(nj.predict(...))` takes a scene's, `to_xarray(**forecasts_of(...))` a test set's.

    Args:
        forecast: [k, A, T, 2] metres.
        period: seconds between steps.
        **arrays: `probability` [k] or [k, A], `truth` [A, T, 2], `observed` [A, obs_len, 2], and
            coordinates [A] by any other name, such as `person`.

    Raises:
        InputError: where xarray is not installed.
    """
    given = {name: np.asarray(of) for name, of in {"forecast": forecast, **arrays}.items()}
    found: dict[str, Any] = {
        name: (DIMENSIONS.get(name, ("agent",))[: of.ndim], of) for name, of in given.items()
    }
    found["xy"] = ["x", "y"]
    found["time"] = period * np.arange(1, given["forecast"].shape[2] + 1)
    if "observed" in given:
        found["past"] = period * np.arange(1 - given["observed"].shape[1], 1)
    dataset = _xarray().Dataset(found, attrs={"units": "metres", "period": period})
    return dataset.set_coords(arrays.keys() - DIMENSIONS.keys())


def _xarray() -> Any:
    try:
        import xarray  # pyright: ignore[reportMissingImports]
    except ImportError:
        raise InputError(".nc files need xarray: pip install 'neurosym-jax[frames]'") from None
    return xarray


def _trajnet_text(found: dict[str, Any]) -> str:
    """Lines of TrajNet++: scenes, tracks, forecasts. The file is one recording, so frames and
    people of several recordings are numbered consecutively."""
    forecast, scene, first = found["forecast"], found["scene"], found["start"].copy()
    happened = np.concatenate([found["observed"], found["truth"]], axis=1)
    steps, begin = happened.shape[1], 0
    for name in dict.fromkeys(found["recording"]):
        of = found["recording"] == name
        first[of] += begin
        begin = int(first[of].max()) + steps
    who = list(zip(found["recording"].tolist(), found["person"].tolist()))
    number = {each: n for n, each in enumerate(dict.fromkeys(who))}
    people = np.array([number[each] for each in who])
    ids, agents = np.unique(scene, return_index=True)
    ends = {"s": first[agents], "e": first[agents] + steps - 1}
    scenes = pl.DataFrame({"id": ids, "p": people[agents], **ends})
    scenes = scenes.with_columns(fps=round(1 / found["period"], 6))
    if "probability" in found:  # The evaluator takes number 0 for the best guess.
        order = np.argsort(-found["probability"], axis=0, kind="stable")
        forecast = np.take_along_axis(forecast, order[..., None, None], axis=0)
    k, _, ahead, _ = forecast.shape
    frames = np.arange(steps - ahead, steps)
    futures = _tracks(forecast.swapaxes(0, 1), people, first[:, None, None] + frames)
    futures = futures.with_columns(
        prediction_number=np.tile(np.repeat(np.arange(k), ahead), len(people)),
        scene_id=np.repeat(scene, k * ahead),
    )
    tracks = _tracks(happened[:, None], people, first[:, None, None] + np.arange(steps))
    once = tracks.unique(["f", "p"], keep="first", maintain_order=True)
    parts = {"scene": [scenes], "track": [once, futures]}
    return "".join(
        part.select(pl.struct(pl.all()).alias(kind)).write_ndjson()
        for kind, of_kind in parts.items()
        for part in of_kind
    )


def _tracks(paths: np.ndarray, people: np.ndarray, frames: np.ndarray) -> pl.DataFrame:
    """A row for each position of `paths` [A, k, T, 2], at `frames` [A, 1, T]."""
    x, y = paths.reshape(-1, 2).T
    frame = np.broadcast_to(frames, paths.shape[:3]).ravel()
    person = np.repeat(people, len(x) // len(people))
    return pl.DataFrame({"f": frame, "p": person, "x": x, "y": y})
