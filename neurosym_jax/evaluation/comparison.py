"""Compare models on recordings: in one call, and by paired tests of results."""

import functools
import re
from collections.abc import Sequence
from typing import Any

import numpy as np
import polars as pl

from neurosym_jax.configuration import Count, refuse
from neurosym_jax.data.clock import on_grid
from neurosym_jax.data.formats import recordings_in
from neurosym_jax.data.reading import ReadOptions
from neurosym_jax.evaluation.intervals import Difference, against_best, paired_difference
from neurosym_jax.evaluation.metrics import METRICS
from neurosym_jax.evaluation.plan import Entries, TestSet, baselines_of, make_test
from neurosym_jax.evaluation.results import Result, Row, Settings, evaluate_tests
from neurosym_jax.evaluation.summary import SEED, rows_frame
from neurosym_jax.forecasting.model import Model

__all__ = ["evaluate", "with_tests"]


def evaluate(
    models: Model | Sequence[Model],
    recordings: Any,
    *,
    samples: int = 20,
    seed: int = 0,
    min_agents: int = 2,
    metrics: Sequence[str] | None = None,
    baselines: Sequence[str] | None = None,
    **read: Any,
) -> pl.DataFrame:
    """Test models on recordings: a row for each model, beside the baselines; see `format_table`.

    Recordings are resampled to the steps that a model was trained on.

    Args:
        models: one or several, see `load_model`.
        recordings: a file, folder, dataframe of pandas or polars, `Tracks`, or several of these.
        samples: number of forecasts of each scene, k.
        seed: random seed of the noise.
        min_agents: scenes with fewer people are left out.
        metrics: names; default: those of every table, see `metric_names`.
        baselines: forecasters by name, see `baselines_of`.
        read: how files and dataframes are read, by the fields of `ReadOptions`: `unit="cm"`, ...

    Returns:
        Columns `model`, `dataset`, `scenes`, ...; for each metric its mean under its name, and the
        bounds of its 95 % interval under `NAME_low` and `NAME_high`; under `NAME_p` the p value of
        the paired test against the best model, see `with_tests`.
    """
    refuse(Count, {"samples": samples, "min_agents": min_agents})
    models = [models] if isinstance(models, Model) else models
    options = ReadOptions(**read)
    recordings = recordings_in(recordings, options)
    name = "+".join(dict.fromkeys(tracks.recording for tracks in recordings))
    tested: dict[tuple[int, int, float], Entries] = {}
    for model in models:
        config = model.config
        key = (config.obs_len, config.pred_len, config.period)
        tested.setdefault(key, []).append((None, model))
    tests = [
        make_test(
            TestSet(name, obs_len, pred_len),
            [*baselines_of(baselines, obs_len, pred_len, samples=samples), *entries],
            [on_grid(tracks, period, options.max_gap) for tracks in recordings],
            min_agents,
        )
        for (obs_len, pred_len, period), entries in tested.items()
    ]
    settings = Settings(samples, seed, None if metrics is None else tuple(metrics))
    return rows_frame(with_tests(list(evaluate_tests(tests, settings))))


def with_tests(results: Sequence[Result]) -> list[Row]:
    """The rows of `results`, with the p value of each metric's paired test under `NAME_p`.

    The test is against the model of best mean on the same test set, which has None, and p is
    adjusted by Holm's method for the number of models. Scenes are paired. Trainings that differ in
    their seed alone count as one model and are paired, too; a single run with each of them.
    """
    rows = [dict(result.row) for result in results]
    lines: dict[Any, dict[Any, list[int]]] = {}
    for number, result in enumerate(results):
        path = result.row["checkpoint"] or ""
        training = re.sub(SEED, "", path) if re.search(SEED, path) else number
        members = lines.setdefault(result.test_set, {})
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
        ours, theirs = ([run.errors for run in lines[number]] for number in (best, other))
        ours = ours * len(theirs) if len(ours) == 1 else ours
        return paired_difference(ours, theirs * len(ours) if len(theirs) == 1 else theirs)

    found = {}
    for column, metric in enumerate(lines[0][0].errors.scores):
        values = [[run.row[metric] for run in line] for line in lines]
        means = [None if None in trainings else float(np.mean(trainings)) for trainings in values]

        def p_value(best: int, other: int, column: int = column) -> float:
            return difference(best, other).over_both.p_value(column)

        found[metric] = against_best(means, METRICS[metric].higher_is_better, p_value)
    return found
