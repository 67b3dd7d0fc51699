"""Rows of an evaluation's report, and reports of sweeps."""

import numpy as np

from neurosym_jax.evaluation.compare import write_report
from neurosym_jax.evaluation.intervals import ErrorsByScene
from neurosym_jax.evaluation.scores import Score
from neurosym_jax.training.sweep import write_errors


def result_row(model, dataset, means, checkpoint=None, half=0.01, p=None, **facts):
    """A row with these means by metric, each with an interval of +- `half`, or without one, and
    `p`, of the first metric's test against the best."""
    row = {
        "checkpoint": checkpoint,
        "model": model,
        "dataset": dataset,
        "obs_len": 8,
        "pred_len": 8,
    }
    row |= {"samples": 20, "seeds": 1, "scenes": 602, "agents": 2253, "blocks": 50}
    row |= {"latency": 0.001, "forecasts_per_second": 1000.0}
    for name, mean in means.items():
        ends = (None, None) if None in (mean, half) else (mean - half, mean + half)
        columns = (name, f"{name}_low", f"{name}_high", f"{name}_std", f"{name}_p")
        row |= dict(zip(columns, (mean, *ends, None, p)))
        p = None
    return row | facts


def write_sweep(folder, runs):
    """Write what a sweep leaves of (model, data set, training seed, errors [S] by metric) each.

    Scenes have three people and begin at consecutive frames; a window has 16 steps.
    What has no seed was not trained.
    """
    rows, errors = [], []
    for model, dataset, seed, errors_by_metric in runs:
        scores = {
            name: Score(3 * values, np.full(len(values), 3.0))
            for name, values in errors_by_metric.items()
        }
        frames = np.arange(len(next(iter(errors_by_metric.values()))))
        identity = np.stack([0 * frames, frames], axis=1).astype(np.uint32)
        errors.append(ErrorsByScene(scores, identity, 16))
        means = dict(zip(scores, errors[-1].mean.tolist()))
        name = None if seed is None else f"{model}_{dataset}_{seed}"
        rows.append(result_row(model, dataset, means, name, training_seed=seed))
    write_report(folder / "sweep.json", rows, {})
    write_errors(folder, errors)
