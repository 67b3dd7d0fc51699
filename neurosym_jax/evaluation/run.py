"""The evaluation that `python evaluate.py` runs: its options, its rows, and what it writes."""

import dataclasses
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import tyro
from tqdm import tqdm

from neurosym_jax.data.batching import make_batches, single_scene
from neurosym_jax.data.sources import open_source
from neurosym_jax.data.windows import Windows, cut_windows
from neurosym_jax.errors import InputError
from neurosym_jax.evaluation.baselines import ConstantVelocity, ConstantVelocitySampled
from neurosym_jax.evaluation.cases import Case, make_cases
from neurosym_jax.evaluation.figures import Shown, draw_figures
from neurosym_jax.evaluation.protocol import Evaluation, evaluate, latency
from neurosym_jax.evaluation.report import FORMAT, check_replaceable, format_table, write_json
from neurosym_jax.forecast import Forecaster
from neurosym_jax.runtime import compile_seconds
from neurosym_jax.scene import pad_scene

__all__ = ["EvaluateOptions", "run_evaluation"]

SHOWN = 8
"""People that a figure can show with ease."""

Row = dict[str, Any]
"""One row of the JSON."""


def _named(metavar: str) -> Any:
    """How `--help` shows an option whose text says what happens without it."""
    return tyro.conf.arg(metavar=metavar, help_behavior_hint="")


@dataclasses.dataclass(frozen=True)
class EvaluateOptions:
    """Evaluate checkpoints beside the constant-velocity baselines: tables, figures, JSON.

    With no arguments: what ships in checkpoints/, on the embedded simulations.
    """

    checkpoint: Annotated[tuple[str, ...], _named("PATH ...")] = ()
    """Folders of ours or SGAN's .pt files, in one table; default: what ships in checkpoints/."""
    data: Annotated[Path | None, _named("PATH")] = None
    """ETH/UCY as SGAN arranges it, or a text file (or a folder of them) of `frame ped x y`;
    default: the embedded simulations."""
    scene: Annotated[str | None, _named("NAME")] = None
    """One scene (eth, hotel, ..., or a file's name); default: a checkpoint's own, else all."""
    test_on: Annotated[tuple[str, ...], _named("NAME ...")] = ()
    """Recordings by file name, taken as one test set, whatever a checkpoint was trained for."""
    obs_len: Annotated[int | None, _named("INT")] = None
    """Observed steps; default: the checkpoint's, else 8."""
    pred_len: Annotated[int | None, _named("INT")] = None
    """Steps to forecast; default: the checkpoint's, else 8."""
    samples: int = 20
    """Forecasts of each scene, k."""
    seed: int = 0
    """Determines, with the scene and the sample, the noise."""
    min_agents: int = 2
    """Scenes with fewer people are left out; SGAN's protocol keeps scenes of at least two."""
    json: Path = Path("results/evaluation.json")
    """File for the rows."""
    plots: Path = Path("results/figures")
    """Folder for the figures."""
    figures: bool = True
    """Draw figures."""
    collisions: bool = True
    """Compute the collision rate, the only part whose work is quadratic in people."""

    def validate(self) -> None:
        """Refuse, before the work and not after it, what cannot be evaluated or written."""
        for name in ("samples", "min_agents", "obs_len", "pred_len"):
            value = getattr(self, name)
            if value is not None and value < 1:
                raise InputError(f"--{name.replace('_', '-')} must be at least 1, not {value}")
        if not 0 <= self.seed < 2**32:
            raise InputError(f"--seed must lie in [0, 2**32), not {self.seed}")
        check_replaceable(self.json)
        if self.figures and self.plots.exists() and not self.plots.is_dir():
            raise InputError(f"{self.plots}: is not a folder, so no figures can be written into it")


def run_evaluation(options: EvaluateOptions) -> list[Row]:
    """Evaluate, print and write what `options` ask for; returns the rows of the JSON.

    Raises:
        InputError: for data, checkpoints or options that cannot be used.
    """
    options.validate()
    start = time.perf_counter()
    cases = make_cases(
        open_source(options.data),
        options.checkpoint,
        scene=options.scene,
        test_on=options.test_on,
        obs_len=options.obs_len,
        pred_len=options.pred_len,
    )
    loading = time.perf_counter() - start
    total = sum(len(case.models) + 2 for case in cases)
    rows: list[Row] = []
    shown: list[Shown] = []
    with tqdm(total=total, desc="evaluating", unit="model", disable=None, leave=False) as bar:
        for case in cases:
            for row in _evaluate_case(case, options, shown):
                rows.append(row)
                bar.update()
    rows[0]["seconds"]["loading"] += loading
    write_json(options.json, {"format": FORMAT, "rows": rows})
    print(format_table(rows))
    if not any(case.models for case in cases):
        print("\nNo checkpoint was given and none that ships fits: these are the baselines.")
    spent = {name: sum(row["seconds"][name] for row in rows) for name in rows[0]["seconds"]}
    print(
        f"\nseconds: {spent['loading']:.1f} loading, {spent['compiling']:.1f} compiling, "
        f"{spent['evaluating']:.1f} evaluating\nrows: {options.json}"
    )
    if options.figures:
        before = set(options.plots.glob("*.png"))
        paths = draw_figures(options.plots, shown)
        replaced = len(before.intersection(paths))
        note = f", {replaced} of them replaced" if replaced else ""
        print(f"figures: {len(paths)} in {options.plots}{note}")
    return rows


def _evaluate_case(case: Case, options: EvaluateOptions, shown: list[Shown]) -> Iterator[Row]:
    """Rows of the baselines and then of the case's checkpoints."""
    start = time.perf_counter()
    test = case.test_set
    windows = cut_windows(
        case.recordings, test.obs_len, test.pred_len, min_agents=options.min_agents
    )
    batches = make_batches(windows)
    loading = time.perf_counter() - start
    common = {"samples": options.samples, "seed": options.seed}
    example = None
    for checkpoint, name, forecaster, params in _contestants(case):
        result = evaluate(forecaster, params, batches, with_collisions=options.collisions, **common)
        if example is None:
            example = single_scene(windows, _typical(windows, result))
            # One size for most test sets, because each costs a program for every model.
            example = pad_scene(example, max(SHOWN, len(example.valid)))
        compiled = compile_seconds()
        seconds, forecast = latency(forecaster, params, example, **common)
        compiled = compile_seconds() - compiled
        shown.append(Shown(test, name, example, forecast, result.horizon))
        yield {
            "checkpoint": checkpoint,
            "model": name,
            **dataclasses.asdict(test),
            "samples": result.samples,
            "seed": options.seed,
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
