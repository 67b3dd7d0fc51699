"""From cases to rows: every model beside the baselines on its test set, as the JSON has it."""

import dataclasses
import time
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from tqdm import tqdm

from neurosym_jax.data.batching import make_batches, single_scene
from neurosym_jax.data.windows import Windows, cut_windows
from neurosym_jax.evaluation.baselines import ConstantVelocity, ConstantVelocitySampled
from neurosym_jax.evaluation.cases import Case
from neurosym_jax.evaluation.figures import Shown
from neurosym_jax.evaluation.protocol import Evaluation, evaluate, latency
from neurosym_jax.forecaster import Forecaster
from neurosym_jax.runtime import compile_seconds
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


def evaluate_cases(cases: Sequence[Case], settings: Settings) -> tuple[list[Row], list[Shown]]:
    """Rows of all cases in their order, the baselines before the models, and what to draw of each.

    Raises:
        InputError: for recordings without a single window.
    """
    rows: list[Row] = []
    shown: list[Shown] = []
    total = sum(len(case.models) + 2 for case in cases)
    with tqdm(total=total, desc="evaluating", unit="model", disable=None, leave=False) as bar:
        for case in cases:
            for row, of_row in _evaluate_case(case, settings):
                rows.append(row)
                shown.append(of_row)
                bar.update()
    return rows, shown


def _evaluate_case(case: Case, settings: Settings) -> Iterator[tuple[Row, Shown]]:
    """The baselines and then the case's checkpoints."""
    start = time.perf_counter()
    test = case.test_set
    windows = cut_windows(
        case.recordings, test.obs_len, test.pred_len, min_agents=settings.min_agents
    )
    batches = make_batches(windows)
    loading = time.perf_counter() - start
    common = {"samples": settings.samples, "seed": settings.seed}
    asked = {**common, "with_collisions": settings.collisions}
    example = None
    for checkpoint, name, forecaster, params in _contestants(case):
        result = evaluate(forecaster, params, batches, **asked)
        if example is None:
            example = single_scene(windows, _typical(windows, result))
            # One size for most test sets, because each costs a program for every model.
            example = pad_scene(example, max(SHOWN, len(example.valid)))
        compiled = compile_seconds()
        seconds, forecast = latency(forecaster, params, example, **common)
        compiled = compile_seconds() - compiled
        row = {
            "checkpoint": checkpoint,
            "model": name,
            **dataclasses.asdict(test),
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
        yield row, Shown(test, name, example, forecast, result.horizon)
        loading = 0.0


def _contestants(case: Case) -> Iterator[tuple[str | None, str, Forecaster, Any]]:
    """(checkpoint, model, forecaster, params), plain constant velocity first."""
    pred_len = case.test_set.pred_len
    yield None, "constant velocity", ConstantVelocity(pred_len), ()
    yield None, "constant velocity, sampled", ConstantVelocitySampled(pred_len), ()
    for path, model in case.models:
        yield path, model.name, model.forecaster, model.params


def _typical(windows: Windows, constant_velocity: Evaluation) -> int:
    """The scene to show: of those with at most `SHOWN` people, the one that constant velocity
    forecasts with the median error, so that neither luck nor taste chooses it."""
    error = np.asarray(constant_velocity.errors.joint_ade) / windows.sizes
    small = np.flatnonzero(windows.sizes <= max(SHOWN, windows.sizes.min()))
    return int(small[np.argsort(error[small], kind="stable")[len(small) // 2]])
