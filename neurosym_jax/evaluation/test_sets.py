"""Test sets: the windows of a dataset at a horizon, and the models to test on them."""

import dataclasses
import time
import warnings
from collections.abc import Sequence

from neurosym_jax.data.batching import Batch, make_batches
from neurosym_jax.data.leakage import seen_before
from neurosym_jax.data.tracks import Tracks
from neurosym_jax.data.windows import Windows, cut_windows
from neurosym_jax.errors import InputError, InputWarning
from neurosym_jax.forecasting.forecasters import FORECASTERS
from neurosym_jax.forecasting.model import Model

__all__ = ["BASELINES", "Entries", "Test", "TestSet", "baseline", "make_test"]

BASELINES = ("constant_velocity", "constant_velocity_sampled")
"""Forecasters that every model is tested beside, by name."""

Entries = list[tuple[str | None, Model]]
"""(path as given, model) of what is tested on one test set; baselines, first, have no path."""


@dataclasses.dataclass(frozen=True)
class TestSet:
    """A dataset at a horizon."""

    dataset: str
    """Its name, or names of recordings joined by `+`."""
    obs_len: int
    pred_len: int


@dataclasses.dataclass(frozen=True, eq=False)
class Test:
    """A test set, read and batched, and the models to test on it."""

    test_set: TestSet
    entries: Entries
    windows: Windows
    batches: list[Batch]
    seconds: float
    """Time taken to read, cut and batch it."""


def baseline(name: str, obs_len: int, pred_len: int) -> Model:
    """Make a registered forecaster without parameters, at a horizon.

    Raises:
        InputError: for an unknown name, or a forecaster with parameters.
    """
    forecaster = FORECASTERS[name]
    try:
        config = forecaster.Config(obs_len=obs_len, pred_len=pred_len)
    except TypeError as error:
        raise InputError(f"forecaster {name}: cannot be a baseline ({error})") from None
    if forecaster(config).shapes():
        raise InputError(f"forecaster {name}: cannot be a baseline, it has parameters to learn")
    return Model(config, {}, kind=name)


def make_test(
    test_set: TestSet,
    entries: Entries,
    recordings: Sequence[Tracks],
    min_agents: int = 2,
    start: float | None = None,
) -> Test:
    """Cut `recordings` into the windows of a test set; its seconds count from `start`."""
    start = time.perf_counter() if start is None else start
    windows = cut_windows(recordings, test_set.obs_len, test_set.pred_len, min_agents=min_agents)
    for path, model in entries:
        found, looked = seen_before(model.seen, windows)
        if found:
            line = (
                f"{path}: was trained on these people: {found} of {looked} windows that were "
                "looked for are among its training windows, so its errors are too small"
            )
            warnings.warn(line, InputWarning, stacklevel=2)
            first = windows.reading[0]
            first = dataclasses.replace(first, warnings=(*first.warnings, line))
            windows = dataclasses.replace(windows, reading=(first, *windows.reading[1:]))
        trained = model.config.period
        if path is not None and abs(trained - windows.period) > 0.01 * trained:
            warnings.warn(
                f"{path}: was trained on steps of {trained:g} s and is tested on steps of "
                f"{windows.period:g} s (--period {trained:g} resamples the recordings)",
                InputWarning,
                stacklevel=2,
            )
    batches = make_batches(windows)
    return Test(test_set, entries, windows, batches, time.perf_counter() - start)
