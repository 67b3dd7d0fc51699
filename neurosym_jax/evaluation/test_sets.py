"""Test sets: the windows of a dataset at a horizon, and the models to test on them."""

import dataclasses
import time
import warnings
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor

from neurosym_jax.data.batching import Batch, make_batches
from neurosym_jax.data.sources import Source
from neurosym_jax.data.tracks import Tracks
from neurosym_jax.data.windows import Windows, cut_windows
from neurosym_jax.errors import InputError, InputWarning
from neurosym_jax.forecasting.forecasters import FORECASTERS
from neurosym_jax.forecasting.model import Model
from neurosym_jax.runtime.environment import cpu_cores

__all__ = ["BASELINES", "Entries", "Test", "TestSet", "baseline", "load_tests", "make_test"]

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
    kind = FORECASTERS[name]
    try:
        config = kind.config(obs_len=obs_len, pred_len=pred_len)
    except TypeError as error:
        raise InputError(f"forecaster {name}: cannot be a baseline ({error})") from None
    if kind.shapes is not None and kind.shapes(config):
        raise InputError(f"forecaster {name}: cannot be a baseline, it has parameters to learn")
    return Model(config, {}, kind=name)


def load_tests(
    source: Source,
    plan: Mapping[TestSet, Entries],
    *,
    test_on: Sequence[str] = (),
    min_agents: int = 2,
    start: float | None = None,
) -> list[Test]:
    """Read the plan's test sets, in its order; each recording once.

    Args:
        source: of the recordings.
        plan: see `make_plan`.
        test_on: names of the recordings, where the plan is of those.
        min_agents: scenes with fewer people are left out.
        start: `time.perf_counter()` from which the first test set's seconds count.

    Raises:
        InputError: for recordings that cannot be read, or have no window.
    """
    since = time.perf_counter() if start is None else start

    def read(name: str) -> list[Tracks]:
        return source.files(test_on) if test_on else source.recordings(name)

    names = list(dict.fromkeys(test_set.dataset for test_set in plan))
    # Side by side, for simulations are programs that are compiled first.
    with ThreadPoolExecutor(cpu_cores()) as pool:
        recordings = dict(zip(names, pool.map(read, names)))
    tests: list[Test] = []
    for test_set, entries in plan.items():
        tests.append(make_test(test_set, entries, recordings[test_set.dataset], min_agents, since))
        since = time.perf_counter()
    return tests


def make_test(
    test_set: TestSet,
    entries: Entries,
    recordings: Sequence[Tracks],
    min_agents: int = 2,
    start: float | None = None,
) -> Test:
    """Cut `recordings` into the windows of a test set; its seconds count from `start`.

    Raises:
        InputError: for recordings without a window.
    """
    start = time.perf_counter() if start is None else start
    windows = cut_windows(recordings, test_set.obs_len, test_set.pred_len, min_agents=min_agents)
    for path, model in entries:
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
