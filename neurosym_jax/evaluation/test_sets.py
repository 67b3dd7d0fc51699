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
from neurosym_jax.forecasting.model_folder import load_model
from neurosym_jax.forecasting.model_places import find_model, shipped_name

__all__ = ["BASELINES", "Entries", "Test", "TestSet", "baseline", "baselines_of", "make_test"]

BASELINES = ("constant_velocity", "constant_velocity_sampled", "anchor_table")
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
        raise InputError(
            f"forecaster {name}: cannot be a baseline, it has parameters to learn, and none ships "
            "for this test set"
        )
    return Model(config, {}, kind=name)


def baselines_of(
    names: Sequence[str] | None,
    obs_len: int,
    pred_len: int,
    dataset: str | None = None,
    samples: int = 20,
) -> list[tuple[None, Model]]:
    """The baselines of a test set.

    One with parameters is the shipped model `NAME_DATASET_STEPS` that did not learn from the test
    set, such as `anchor_table_zara1_12`.

    Args:
        names: of forecasters; None for `BASELINES`, without those that do not ship for this test
            set or have fewer samples.
        obs_len: observed steps.
        pred_len: steps to forecast.
        dataset: of ETH/UCY, or general for recordings of other people.
        samples: k that is asked for.

    Raises:
        InputError: as `baseline`, and for one of `names` with parameters that does not ship.
    """
    found: list[tuple[None, Model]] = []
    for name in BASELINES if names is None else names:
        place = find_model(shipped_name(name, dataset, pred_len))
        if not place.is_dir():
            if names is not None or not _learned(name, obs_len, pred_len):
                found.append((None, baseline(name, obs_len, pred_len)))
            continue
        model = load_model(place)
        fits = (
            model.config.obs_len == obs_len and getattr(model.config, "samples", samples) >= samples
        )
        if names is not None or fits:
            found.append((None, model))
    return found


def _learned(name: str, obs_len: int, pred_len: int) -> bool:
    """Whether a forecaster has parameters."""
    forecaster = FORECASTERS[name]
    return bool(forecaster(forecaster.Config(obs_len=obs_len, pred_len=pred_len)).shapes())


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
