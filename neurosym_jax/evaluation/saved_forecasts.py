"""Forecasts of a whole test set in a file: NumPy arrays, xarray's netCDF, or TrajNet++ lines.

The test set is forecast again; with the same seed these are the forecasts that were
scored.
"""

import re
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from neurosym_jax.errors import InputError, optional_module
from neurosym_jax.evaluation.forecasts import last_frames, recording_names
from neurosym_jax.evaluation.plan import Test
from neurosym_jax.evaluation.trajnet import DECIMALS, write_trajnet
from neurosym_jax.forecasting.batched import forecast_windows
from neurosym_jax.forecasting.model import Model
from neurosym_jax.runtime.files import new_file, refuse_unwritable
from neurosym_jax.runtime.process import cpu_cores, refuse_beyond_memory

__all__ = ["check_forecasts_file", "forecasts_of", "save_forecasts", "to_xarray"]

ENDINGS = (".npz", ".nc", ".ndjson")
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

    The ending of `path`, .npz, .nc (see `to_xarray`) or .ndjson (TrajNet++), is the
    format; `seed` is the noise's. Returns the files; existing ones of the same name
    were replaced.
    """
    check_forecasts_file(path)
    entries = [(test, *entry) for test in tests for entry in test.entries]
    paths: list[Path] = []
    for test, checkpoint, model in entries:
        name = Path(checkpoint or model.family).name.removesuffix(".pt")
        parts = [
            path.stem,
            test.test_set.dataset,
            test.test_set.obs_len,
            test.test_set.pred_len,
        ]
        stem = "_".join(map(str, [*parts, re.sub(r"[^\w.+-]+", "_", name)]))
        target = path.with_name(stem + path.suffix) if len(entries) > 1 else path
        while target in paths:
            target = target.with_stem(f"{target.stem}_")
        paths.append(target)
        if path.suffix.lower() == ".ndjson":
            paths.append(write_trajnet(target, model, test, samples, seed))
            continue
        arrays = forecasts_of(model, test, samples, seed)
        for name in ("samples", "truth", "observed"):
            arrays[name] = np.round(arrays[name], DECIMALS)
        with new_file(target) as beside:
            if path.suffix.lower() == ".nc":
                to_xarray(**arrays).to_netcdf(beside, engine="scipy")
            else:
                np.savez_compressed(beside, **arrays)
    return paths


def forecasts_of(model: Model, test: Test, samples: int, seed: int) -> dict[str, Any]:
    """Forecast a whole test set of A agent windows by `model`, in their order.

    Returns:
        World metres `samples` [k, A, pred_len, 2], `truth` [A, pred_len, 2] and
        `observed` [A, obs_len, 2]; [A] `ids`, `frames` (the last observed one: its
        number or, where the file has none, its time in seconds), `recordings`, `scene`
        and `start`, the index of the first step; `period` in seconds; and, where
        samples have them, `probabilities` [k, A].
    """
    windows, obs_len, forecaster = test.windows, test.windows.obs_len, model.forecaster
    samples = forecaster.count(samples)
    numbers = 2.0 * samples * windows.agents * forecaster.pred_len
    refuse_beyond_memory("saving forecasts", 24 * numbers, "ask for fewer samples")
    with ThreadPoolExecutor(cpu_cores()) as pool:
        futures, likely = forecast_windows(
            model, windows, test.batches, samples, seed, pool.map
        )
    scene = np.repeat(np.arange(windows.scenes), windows.sizes)
    return {
        "samples": futures,
        "truth": windows.position[:, obs_len:],
        "observed": windows.position[:, :obs_len],
        "scene": scene,
        "ids": windows.agent,
        "frames": last_frames(windows)[scene],
        "recordings": recording_names(windows)[scene],
        "start": windows.identity[scene, 1].astype(np.int64),
        "period": windows.period,
        **({} if likely is None else {"probabilities": likely[:, scene]}),
    }


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
    values = {
        name: np.asarray(array)
        for name, array in {"samples": samples, **arrays}.items()
    }
    variables: dict[str, Any] = {
        name: (DIMENSIONS.get(name, ("agent",))[: array.ndim], array)
        for name, array in values.items()
    }
    variables["xy"] = ["x", "y"]
    variables["time"] = period * np.arange(1, values["samples"].shape[2] + 1)
    if "observed" in values:
        variables["past"] = period * np.arange(1 - values["observed"].shape[1], 1)
    dataset = _xarray().Dataset(variables, attrs={"units": "metres", "period": period})
    return dataset.set_coords(arrays.keys() - DIMENSIONS.keys())


def _xarray() -> Any:
    return optional_module("xarray", "a .nc file", "frames")
