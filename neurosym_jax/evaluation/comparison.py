"""Compare models, functions and saved forecasts on recordings, and test their differences."""

import dataclasses
import functools
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
import polars as pl

from neurosym_jax.configuration import Count, refuse
from neurosym_jax.data.recordings import recordings_in
from neurosym_jax.data.tables import AS_IT_SAYS, ReadOptions
from neurosym_jax.data.tracks import PERIOD
from neurosym_jax.data.windows import on_grid
from neurosym_jax.errors import InputError, option
from neurosym_jax.evaluation.forecasts import (
    ForecastFile,
    match,
    matched,
    read_named,
    windows_of,
)
from neurosym_jax.evaluation.functions import Predictor, predict_windows
from neurosym_jax.evaluation.intervals import (
    Difference,
    against_best,
    paired_difference,
)
from neurosym_jax.evaluation.metrics import METRICS
from neurosym_jax.evaluation.plan import (
    LENGTH,
    Entries,
    Test,
    TestSet,
    baselines_of,
    make_test,
)
from neurosym_jax.evaluation.results import Result, Row, Settings, evaluate_tests
from neurosym_jax.evaluation.summary import SEED, rows_frame
from neurosym_jax.forecasting.model import Model

__all__ = ["add_forecasts", "evaluate", "test_of_file", "with_tests"]

OF_WINDOWS = ("obs_len", "pred_len", "period", "min_agents", "test_on", "cluster")
"""Options, beside those of reading, without effect where a file of forecasts has the windows."""


def evaluate(
    models: Model
    | Predictor
    | Sequence[Model | Predictor]
    | Mapping[str, Model | Predictor] = (),
    recordings: Any = None,
    *,
    forecasts: Path | str | Sequence[Path | str] | Mapping[str, Path | str] = (),
    samples: int = 20,
    seed: int = 0,
    min_agents: int = 2,
    metrics: Sequence[str] | None = None,
    baselines: Sequence[str] | None = None,
    obs_len: int | None = None,
    pred_len: int | None = None,
    period: float | None = None,
    partial: bool = False,
    **read: Any,
) -> pl.DataFrame:
    """Test models on recordings: a row for each model, beside the baselines; see `format_table`.

    Recordings are resampled to the steps that a model was trained on.

    Args:
        models: one or several, see `load_model`; also functions of numpy or torch, see
            `functions.Predictor`: `lambda observed: ...`. A mapping has their names in
            tables.
        recordings: a file, folder, dataframe of pandas or polars, `Tracks`, or several
            of these; None for those that the first file of forecasts holds.
        forecasts: files of forecasts, see `read_forecasts`, one or several or by name.
        samples: number of forecasts of each scene, k.
        seed: random seed of the noise.
        min_agents: scenes with fewer people are left out.
        metrics: names; default: those of every table, see `metric_names`.
        baselines: forecasters by name, see `baselines_of`.
        obs_len: steps observed where no model says how many; default: 8.
        pred_len: steps to forecast where no model says; default: those of the files,
            else 8.
        period: seconds between steps where no model says; default: 0.4.
        partial: test on the windows that all files of forecasts have, and leave out the
            rest.
        read: how files and dataframes are read, by the fields of `ReadOptions`:
            `unit="cm"`, ...

    Returns:
        Columns `model`, `dataset`, `scenes`, ...; for each metric its mean under its
        name, and the bounds of its 95 % interval under `NAME_low` and `NAME_high`;
        under `NAME_p` the p value of the paired test against the best model, see
        `with_tests`.

    Raises:
        InputError: for what cannot be read or does not match, and where nothing is to
            be tested.
    """
    refuse(Count, {"samples": samples, "min_agents": min_agents})
    loaded, functions = _apart(models)
    files = read_named(forecasts) if forecasts else {}
    lengths = {"obs_len": obs_len, "pred_len": pred_len, "period": period}
    for name, value in lengths.items():
        for model in loaded.values():
            if value not in (None, own := getattr(model.config, name)):
                raise InputError(f"{name} {value}: {model.name} has {own}")
    if partial and not files:
        raise InputError("partial: there are no files of forecasts")
    options = ReadOptions(**read)
    if recordings is None:
        if loaded or not files:
            raise InputError("recordings: there are none to test on")
        chosen = {**lengths, "min_agents": min_agents != 2, **read}
        tests = [test_of_file(*next(iter(files.items())), baselines, samples, chosen)]
    else:
        tracks = recordings_in(recordings, options)
        tested: dict[tuple[int, int, float], Entries] = {}
        for name, model in loaded.items():
            config = model.config
            key = (config.obs_len, config.pred_len, config.period)
            path = name if isinstance(models, Mapping) else None
            tested.setdefault(key, []).append((path, model))
        if not tested:
            steps = pred_len or next((file.steps for file in files.values()), LENGTH)
            tested[obs_len or LENGTH, steps, period or PERIOD] = []
        dataset = "+".join(dict.fromkeys(recording.recording for recording in tracks))
        tests = [
            make_test(
                TestSet(dataset, seen, ahead),
                [*baselines_of(baselines, seen, ahead, samples=samples), *entries],
                [on_grid(recording, step, options.max_gap) for recording in tracks],
                min_agents,
            )
            for (seen, ahead, step), entries in tested.items()
        ]
    if files or functions:
        tests = add_forecasts(tests, files, functions, partial=partial)
    labels = {name: name for name in loaded} | {
        str(file.path): name for name, file in files.items()
    }
    settings = Settings(
        samples, seed, None if metrics is None else tuple(metrics), labels=labels
    )
    return rows_frame(with_tests(list(evaluate_tests(tests, settings))))


def _apart(models: Any) -> tuple[dict[str, Model], dict[str, Predictor]]:
    """Models and functions by name or, where they have none, their number."""
    if isinstance(models, Model) or callable(models):
        models = [models]
    if not isinstance(models, Mapping):
        names = (getattr(model, "__name__", "").strip("<>") for model in models)
        models = {
            f"{name} {number}" if number and name else name or str(number): model
            for number, (name, model) in enumerate(zip(names, models))
        }
    for name, model in models.items():
        if not (isinstance(model, Model) or callable(model)):
            raise InputError(f"{name}: is no model or function: {type(model).__name__}")
    loaded = {name: model for name, model in models.items() if isinstance(model, Model)}
    return loaded, {name: model for name, model in models.items() if name not in loaded}


def test_of_file(
    name: str,
    file: ForecastFile,
    baselines: Sequence[str] | None,
    samples: int,
    options: Mapping[str, Any],
) -> Test:
    """The test set that a file holds itself, with what happened, and its baselines.

    Raises:
        InputError: for `options` that would choose other windows.
    """
    if unused := [key for key in (*OF_WINDOWS, *vars(AS_IT_SAYS)) if options.get(key)]:
        raise InputError(
            f"{option(unused[0])}: has no effect on windows of a file of forecasts"
        )
    windows = windows_of(file)
    obs_len, pred_len = windows.obs_len, windows.position.shape[1] - windows.obs_len
    recordings = sorted({reading.recording for reading in windows.reading} - {""})
    test_set = TestSet("+".join(recordings) or name, obs_len, pred_len)
    entries = baselines_of(baselines, obs_len, pred_len, samples=samples)
    return Test(test_set, entries, windows)


def add_forecasts(
    tests: Sequence[Test],
    files: Mapping[str, ForecastFile],
    predictors: Mapping[str, Predictor] = MappingProxyType({}),
    *,
    partial: bool = False,
) -> list[Test]:
    """Add forecasts of files and functions, by name, to the test sets that they are of.

    Args:
        tests: see `make_test`.
        files: see `read_forecasts`; each is of the test sets of its recordings and
            length.
        predictors: functions, which forecast all test sets.
        partial: test on the windows that all files have, see `match`; else all must
            match.

    Raises:
        InputError: for a file that is of no test set, or that could be of several.
    """
    chosen: dict[int, dict[str, ForecastFile]] = {
        number: {} for number in range(len(tests))
    }
    for name, file in files.items():
        steps, own = (
            file.steps,
            set(map(str, [] if file.recordings is None else file.recordings)),
        )
        likely = [
            at for at, test in enumerate(tests) if test.test_set.pred_len == steps
        ]
        numbers = [at for at in likely if not own or own & _recordings(tests[at])]
        foreign = own - {
            recording for at in numbers for recording in _recordings(tests[at])
        }
        if not numbers or (foreign and not partial) or (not own and len(numbers) > 1):
            sets = ", ".join(dict.fromkeys(test.test_set.dataset for test in tests))
            lengths = ", ".join(
                map(str, sorted({test.test_set.pred_len for test in tests}))
            )
            kind = (
                f"recordings {', '.join(sorted(foreign)[:6])}"
                if foreign
                else "one recording"
            )
            raise InputError(
                f"{file.path}: forecasts of {steps} steps of {kind}; tested are {sets}, {lengths} "
                "steps: choose the data set and the steps that were forecast"
            )
        for number in numbers:
            chosen[number][name] = file
    return [
        _with_forecasts(test, chosen[number], predictors, partial)
        for number, test in enumerate(tests)
    ]


def _recordings(test: Test) -> set[str]:
    return {reading.recording for reading in test.windows.reading}


def _with_forecasts(
    test: Test,
    files: Mapping[str, ForecastFile],
    predictors: Mapping[str, Predictor],
    partial: bool,
) -> Test:
    windows, rows = test.windows, {}
    complete = np.ones(windows.scenes, bool)
    for name, file in files.items():
        covered, rows[name] = match(file, windows, partial=partial)
        complete &= covered
    if not complete.any():
        raise InputError(f"{', '.join(files)}: no window is in all of these files")
    people, windows = np.repeat(complete, windows.sizes), windows.take(complete)
    forecasts = [
        (str(file.path), matched(file, name, windows, rows[name][people]))
        for name, file in files.items()
    ]
    forecasts += [
        (None, predict_windows(function, name, windows))
        for name, function in predictors.items()
    ]
    return dataclasses.replace(test, windows=windows, forecasts=forecasts)


def with_tests(results: Sequence[Result]) -> list[Row]:
    """The rows of `results`, with the p value of each metric's paired test under `NAME_p`.

    The test is against the model of best mean on the same test set, which has None, and
    p is adjusted by Holm's method for the number of models. Scenes are paired.
    Trainings that differ in their seed alone count as one model and are paired, too; a
    single run with each of them.
    """
    rows = [dict(result.row) for result in results]
    lines: dict[Any, dict[Any, list[int]]] = {}
    for number, result in enumerate(results):
        path = result.row["checkpoint"] or ""
        training = re.sub(SEED, "", path) if re.search(SEED, path) else number
        # Of another period the windows are others.
        members = lines.setdefault((result.test_set, result.period), {})
        members.setdefault((result.name, training), []).append(number)
    for members in lines.values():
        runs = [[results[number] for number in numbers] for numbers in members.values()]
        for metric, p_values in _p_values(runs).items():
            for numbers, p in zip(members.values(), p_values):
                for number in numbers:
                    rows[number][f"{metric}_p"] = p
    return rows


def _p_values(lines: list[list[Result]]) -> dict[str, list[float | None]]:
    """By metric, for each line of one test set, which has one training or several."""

    @functools.cache
    def difference(best: int, other: int) -> Difference:
        runs, other_runs = (
            [run.errors for run in lines[number]] for number in (best, other)
        )
        runs = runs * len(other_runs) if len(runs) == 1 else runs
        return paired_difference(
            runs, other_runs * len(runs) if len(other_runs) == 1 else other_runs
        )

    p_by_metric = {}
    for column, metric in enumerate(lines[0][0].errors.scores):
        values = [[run.row[metric] for run in line] for line in lines]
        means = [
            None if None in trainings else float(np.mean(trainings))
            for trainings in values
        ]

        def p_value(best: int, other: int, column: int = column) -> float:
            return difference(best, other).over_both.p_value(column)

        p_by_metric[metric] = against_best(
            means, METRICS[metric].higher_is_better, p_value
        )
    return p_by_metric
