"""From a plan to what is to be forecast: recordings are read, cut into windows and batched."""

import dataclasses
import time
import warnings
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor

from neurosym_jax.data.batching import Batch, make_batches
from neurosym_jax.data.sources import Source
from neurosym_jax.data.tracks import Tracks
from neurosym_jax.data.windows import Windows, cut_windows
from neurosym_jax.errors import InputWarning
from neurosym_jax.evaluation.plan import Entries, TestSet
from neurosym_jax.runtime.environment import cpu_cores

__all__ = ["Test", "files_read", "load_tests", "make_test"]


@dataclasses.dataclass(frozen=True, eq=False)
class Test:
    """A test set, ready to be forecast, and what is tested on it."""

    test_set: TestSet
    entries: Entries
    windows: Windows
    batches: list[Batch]
    seconds: float
    """Of reading, cutting and batching."""


def load_tests(
    source: Source,
    plan: Mapping[TestSet, Entries],
    *,
    test_on: Sequence[str] = (),
    min_agents: int = 2,
    start: float | None = None,
) -> list[Test]:
    """The plan's test sets, in its order; each recording is read once.

    Args:
        source: of the recordings.
        plan: see `make_plan`.
        test_on: the recordings, where the plan is of those.
        min_agents: scenes with fewer people are left out.
        start: `time.perf_counter()` from which the first one's seconds count.

    Raises:
        InputError: for recordings that cannot be read, or are without a single window.
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


def files_read(tests: Sequence[Test]) -> list[str]:
    """The files that the recordings of `tests` were read from."""
    return [how.file for test in tests for how in test.windows.reading if how.file]


def make_test(
    test_set: TestSet,
    entries: Entries,
    recordings: Sequence[Tracks],
    min_agents: int = 2,
    start: float | None = None,
) -> Test:
    """A test set of `recordings`; its seconds count from `start`.

    Raises:
        InputError: for recordings without a single window.
    """
    start = time.perf_counter() if start is None else start
    windows = cut_windows(recordings, test_set.obs_len, test_set.pred_len, min_agents=min_agents)
    for path, model in entries:
        trained = model.config.period
        if path is not None and abs(trained - windows.period) > 0.01 * trained:
            warnings.warn(
                f"{path}: was trained on steps of {trained:g} s and is tested on steps of "
                f"{windows.period:g} s (--period {trained:g} would bring the test to its own)",
                InputWarning,
                stacklevel=2,
            )
    batches = make_batches(windows)
    return Test(test_set, entries, windows, batches, time.perf_counter() - start)
