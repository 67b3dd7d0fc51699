"""From cases to rows: every model beside the baselines on its test set, as the JSON has it."""

import dataclasses
import time
import warnings
from collections.abc import Iterator, Sequence
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from typing import Any

import numpy as np
from tqdm import tqdm

from neurosym_jax.data.batching import Batch, make_batches, single_scene
from neurosym_jax.data.windows import Windows, cut_windows
from neurosym_jax.errors import InputWarning
from neurosym_jax.evaluation.cases import Case
from neurosym_jax.evaluation.paired import METRICS, ErrorsByScene
from neurosym_jax.evaluation.programs import compile_ahead, compile_single_ahead, wait_for
from neurosym_jax.evaluation.protocol import Evaluation, evaluate, latency
from neurosym_jax.forecasting.baselines import ConstantVelocity, ConstantVelocitySampled
from neurosym_jax.forecasting.forecaster import Forecaster
from neurosym_jax.plotting.evaluation import Shown
from neurosym_jax.runtime.environment import cpu_cores
from neurosym_jax.scene import pad_scene

__all__ = ["Row", "Settings", "evaluate_cases"]

SHOWN = 8
"""People that a figure can show with ease."""

Row = dict[str, Any]
"""One row of the JSON."""


@dataclasses.dataclass(frozen=True)
class Settings:
    """How every case is evaluated."""

    samples: int = 20
    """Forecasts of each scene, k."""
    seed: int = 0
    """Determines, with the scene and the sample, the noise."""
    min_agents: int = 2
    """Scenes with fewer people are left out."""
    collisions: bool = True
    """Whether the collision rate is computed."""


@dataclasses.dataclass(frozen=True, eq=False)
class _Test:
    """A case, its recordings cut, and what takes part in it."""

    case: Case
    windows: Windows
    batches: list[Batch]
    contestants: list[tuple[str | None, str, Forecaster, Any]]
    """(checkpoint, model, forecaster, params), plain constant velocity first."""
    loading: float
    """Seconds."""


def evaluate_cases(
    cases: Sequence[Case], settings: Settings
) -> tuple[list[Row], list[Shown], list[ErrorsByScene]]:
    """Rows of all cases in their order, the baselines before the models; for each also what to
    draw and its errors scene by scene.

    Raises:
        InputError: for recordings without a single window.
    """
    rows: list[Row] = []
    shown: list[Shown] = []
    errors: list[ErrorsByScene] = []
    tests = [_cut(case, settings) for case in cases]
    total = sum(len(test.contestants) for test in tests)
    pool = ThreadPoolExecutor(cpu_cores())
    try:
        for test in tests:
            for _, _, forecaster, params in test.contestants:
                compile_ahead(pool, forecaster, params, test.batches, settings.samples)
                _compile_single(pool, test, SHOWN, forecaster, params, settings)
        with tqdm(total=total, desc="evaluating", unit="model", disable=None, leave=False) as bar:
            for test in tests:
                for row, of_row, by_scene in _evaluate_test(pool, test, settings):
                    rows.append(row)
                    shown.append(of_row)
                    errors.append(by_scene)
                    bar.update()
    finally:
        pool.shutdown(cancel_futures=True)
    return rows, shown, errors


def _cut(case: Case, settings: Settings) -> _Test:
    start = time.perf_counter()
    lengths = case.test_set.obs_len, case.test_set.pred_len
    windows = cut_windows(case.recordings, *lengths, min_agents=settings.min_agents)
    for path, model in case.models:
        trained = model.config.period
        if abs(trained - windows.period) > 0.01 * trained:
            warnings.warn(
                f"{path}: was trained on steps of {trained:g} s and is tested on steps of "
                f"{windows.period:g} s (--period {trained:g} would bring the test to its own)",
                InputWarning,
                stacklevel=2,
            )
    batches = make_batches(windows)
    contestants = [
        (None, "constant velocity", ConstantVelocity(lengths[1]), ()),
        (None, "constant velocity, sampled", ConstantVelocitySampled(lengths[1]), ()),
        *((path, model.name, model.forecaster, model.params) for path, model in case.models),
    ]
    return _Test(case, windows, batches, contestants, time.perf_counter() - start)


def _compile_single(
    pool: Executor, test: _Test, slots: int, forecaster: Forecaster, params: Any, settings: Settings
) -> Future:
    obs_len, samples = test.windows.obs_len, settings.samples
    return compile_single_ahead(pool, forecaster, params, slots, obs_len, samples)


def _evaluate_test(
    pool: Executor, test: _Test, settings: Settings
) -> Iterator[tuple[Row, Shown, ErrorsByScene]]:
    """The baselines and then the case's checkpoints."""
    test_set, windows, loading = test.case.test_set, test.windows, test.loading
    common = {"samples": settings.samples, "seed": settings.seed}
    asked = {**common, "with_collisions": settings.collisions}
    example = None
    for checkpoint, name, forecaster, params in test.contestants:
        result = evaluate(forecaster, params, test.batches, **asked)
        if example is None:
            example = single_scene(windows, _typical(windows, result))
            # One size for most test sets, because each costs a program for every model.
            example = pad_scene(example, max(SHOWN, len(example.valid)))
        slots = len(example.valid)
        compiled = wait_for([_compile_single(pool, test, slots, forecaster, params, settings)])
        seconds, forecast = latency(forecaster, params, example, **common)
        row = {
            "checkpoint": checkpoint,
            "model": name,
            **dataclasses.asdict(test_set),
            "samples": result.samples,
            "seed": settings.seed,
            "scenes": windows.scenes,
            "agents": result.agents,
            "joint": {"ade": result.mean("joint_ade"), "fde": result.mean("joint_fde")},
            "marginal": {"ade": result.mean("marginal_ade"), "fde": result.mean("marginal_fde")},
            "collision_rate": result.collision_rate,
            "seconds": {
                "loading": loading,
                "compiling": result.compiling + compiled,
                "evaluating": result.evaluating,
                "latency": seconds,
            },
            "forecasts_per_second": result.agents * result.samples / result.evaluating,
        }
        by_scene = ErrorsByScene(
            np.stack([getattr(result.errors, metric) for metric in METRICS], axis=1),
            result.errors.agents,
            windows.identity,
            test_set.obs_len + test_set.pred_len,
        )
        shown = Shown(test_set, name, example, forecast, result.horizon, windows.period)
        yield row, shown, by_scene
        loading = 0.0


def _typical(windows: Windows, constant_velocity: Evaluation) -> int:
    """The scene to show: of those with at most `SHOWN` people, the one that constant velocity
    forecasts with the median error, so that neither luck nor taste chooses it."""
    error = np.asarray(constant_velocity.errors.joint_ade) / windows.sizes
    small = np.flatnonzero(windows.sizes <= max(SHOWN, windows.sizes.min()))
    return int(small[np.argsort(error[small], kind="stable")[len(small) // 2]])
