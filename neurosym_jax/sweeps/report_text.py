"""A report's JSON as a page that says what its intervals allow to be said, and as CSV."""

import json
from collections.abc import Sequence
from typing import Any

import numpy as np

from neurosym_jax.configuration import from_json, to_json
from neurosym_jax.evaluation.markdown import csv_text, markdown_table
from neurosym_jax.evaluation.metrics import known_metric
from neurosym_jax.sweeps.learned_tables import agreement
from neurosym_jax.training.recipe import RECIPES, TrainConfig

__all__ = ["format_differences", "format_report"]

INTERVALS = """\
Differences are those of a model and the reference, in the unit of the metric, on the same scenes
with the same noise and seed; below 0 the model is better, unless more of it is. In brackets is the
interval of 95 %: test scenes resampled in blocks of as many start frames as a window has steps
(neighbouring windows share most of their steps), and the mean over seeds drawn from Student's t.
The mean weighs the test sets equally."""

Compared = dict[str, Any]


def format_report(data: dict[str, Any], name: str, command: str) -> str:
    """The Markdown of `sweeps.report`'s JSON.

    Args:
        data: the JSON.
        name: of the files beside it, without an ending.
        command: the one that writes it.
    """
    compared: list[Compared] = data["comparisons"]
    references = list(dict.fromkeys(one["reference"] for one in compared))
    metrics: list[str] = data["metrics"]
    parts = [
        "# Weightings compared",
        f"See which weighting of pairs helps, beside {' and '.join(references)}.",
        *(_answer(compared, metrics, reference) for reference in references),
        _exceptions(compared, metrics),
        f"![Differences and their intervals]({name}.png)",
        INTERVALS,
        *([_learned(data["learned"])] if data["learned"] else []),
        f"Differences on each test set are in `{name}.csv`; errors of all runs, what the "
        f"uncertainty comes from and what was learned in `{name}.json`.",
        "## How it was made",
        _setting(data, command),
    ]
    return "\n\n".join(part.rstrip() for part in parts) + "\n"


def format_differences(data: dict[str, Any]) -> str:
    """All differences of `sweeps.report`'s JSON as CSV: a row for a model, test set and metric."""
    head = ["reference", "model", "test_set", "metric", "error_of_reference", "difference"]
    head += ["low_95", "high_95", "seeds_better", "seeds"]
    rows = [
        [
            *(one["reference"], one["model"], one["scene"], metric),
            *(one[metric]["reference"], one[metric]["difference"], *one[metric]["both"]),
            *(_seeds_better(one, metric), len(one[metric]["of_seeds"])),
        ]
        for one in data["comparisons"]
        for metric in data["metrics"]
    ]
    return csv_text([head, *rows])


def _setting(data: dict[str, Any], command: str) -> str:
    rows = data["rows"]
    recipe = rows[0]["run"]["recipe"]
    # By an earlier version, perhaps, and so without fields of today.
    training, usual = to_json(from_json(TrainConfig, data["training"])), to_json(RECIPES[recipe])
    changes = [
        f"{name}={json.dumps(value)}"
        for name, value in training.items()
        if name != "seed" and value != usual[name]
    ]
    sets = {row["scene"]: f"{row['scene']} ({row['scenes']} windows)" for row in rows}
    seeds = len({row["run"]["seed"] for row in rows})
    alone = "One seed says nothing of others. " if seeds == 1 else ""
    return (
        f"{len(rows)} runs of one budget: recipe `{recipe}`"
        f"{' with ' + ', '.join(f'`{change}`' for change in changes) if changes else ''}, "
        f"{rows[0]['obs_len']} steps observed and {rows[0]['pred_len']} forecast, "
        f"{seeds} seed{'s' * (seeds > 1)}. "
        f"Tested on {', '.join(sets.values())}, "
        f"best of {rows[0]['samples']}. "
        f"{alone}Trained and written by\n\n"
        f"{_command(rows, changes)}\n"
        f"    {command}"
    )


def _command(rows: Sequence[Compared], changes: Sequence[str]) -> str:
    """The sweep's command line."""
    named = {"as_described": "neurosym"}
    models = dict.fromkeys(named.get(row["run"]["model"], row["run"]["model"]) for row in rows)
    kinds = dict.fromkeys(row["run"]["weighting"] for row in rows if row["run"]["weighting"])
    lengths = f"--obs-len {rows[0]['obs_len']} --pred-lens {rows[0]['pred_len']}"
    options = {
        "--models": models,
        "--weightings": kinds,
        "--scenes": dict.fromkeys(row["scene"] for row in rows),
        "--seeds": [str(1 + max(row["run"]["seed"] for row in rows))],
        "--recipe": [rows[0]["run"]["recipe"]],
        "--set": changes,
    }
    words = [f"{name} {' '.join(values)}" for name, values in options.items() if values]
    lines = ["    python -m neurosym_jax sweep --data DATA --out SWEEP", lengths, *words]
    return " \\\n        ".join(lines)


def _of(compared: Sequence[Compared], **named: str) -> list[Compared]:
    return [one for one in compared if all(one[key] == value for key, value in named.items())]


def _whole(compared: Sequence[Compared]) -> str:
    """The test set that speaks for all: the mean, or the only one there is."""
    return "mean" if any(one["scene"] == "mean" for one in compared) else compared[0]["scene"]


def verdict(one: Compared, metric: str) -> str:
    """`better` or `worse` where the interval over scenes and seeds leaves 0 out."""
    low, high = one[metric]["both"]
    if known_metric(metric).higher_is_better:
        low, high = -high, -low
    return "better" if high < 0 else "worse" if low > 0 else "not told apart"


def _answer(compared: Sequence[Compared], metrics: Sequence[str], reference: str) -> str:
    whole = _whole(compared)
    mine = _of(compared, reference=reference, scene=whole)
    where = "in the mean over test sets" if whole == "mean" else f"on {whole}"
    head = [
        f"minus {reference}",
        *(known_metric(m).label for m in metrics),
        "seeds better (joint ADE)",
    ]
    rows = [
        [
            one["model"],
            *(_cell(one, metric) for metric in metrics),
            f"{_seeds_better(one, 'joint_ade')} of {len(one['joint_ade']['of_seeds'])}",
        ]
        for one in mine
    ]
    return (
        f"Difference to `{reference}` {where}; bold where the interval leaves out 0:\n\n"
        f"{markdown_table(head, rows)}\n\n{_bounds(mine, metrics)}"
    )


def _bounds(mine: Sequence[Compared], metrics: Sequence[str]) -> str:
    """How many are told apart at all, and what the intervals still allow."""
    counts = {
        kind: sum(verdict(one, metric) == kind for one in mine for metric in metrics)
        for kind in ("better", "worse")
    }
    low = min(one["joint_ade"]["both"][0] / one["joint_ade"]["reference"] for one in mine)
    high = max(one["joint_ade"]["both"][1] / one["joint_ade"]["reference"] for one in mine)
    return (
        f"Of these {len(mine) * len(metrics)} comparisons ({len(mine)} models, {len(metrics)} "
        f"errors) {counts['better']} are told to be better and {counts['worse']} worse. What the "
        f"intervals allow of joint ADE lies between {_signed(100 * low, 1)} % and "
        f"{_signed(100 * high, 1)} %."
    )


def _exceptions(compared: Sequence[Compared], metrics: Sequence[str]) -> str:
    single = [one for one in compared if one["scene"] != "mean"]
    told = [
        f"- `{one['model']}` is {verdict(one, metric)} than `{one['reference']}` on {one['scene']} "
        f"in {known_metric(metric).title}."
        for one in single
        for metric in metrics
        if verdict(one, metric) != "not told apart"
    ]
    count = len(single) * len(metrics)
    head = (
        f"Of the {count} comparisons on single test sets {len(told)} leave out 0; "
        f"by chance alone it would be about {0.05 * count:.0f}."
    )
    return "\n".join([head, "", *told]) if told else head


def _seeds_better(one: Compared, metric: str) -> int:
    """On how many seeds the model was the better one."""
    sign = -1 if known_metric(metric).higher_is_better else 1
    return sum(sign * value < 0 for value in one[metric]["of_seeds"])


def _learned(learned: dict[str, dict[str, list[list[float]]]]) -> str:
    rows = []
    for model, of_model in learned.items():
        for scene, of_seeds in of_model.items():
            mean = _signed(float(np.mean(of_seeds)))
            spread = float(np.mean(np.std(of_seeds, axis=1)))
            found = agreement(of_seeds)
            told = "-" if found is None else _signed(found, 2)
            rows.append([model, scene, mean, f"{spread:.3f}", told])
    head = ["model", "test set", "mean change", "spread", "correlation of seeds"]
    return (
        "How learned weights of the 16 states without a zero differ from where they started: mean "
        "and spread over the states, and how the changes of two seeds correlate (1: every seed "
        f"learns the same, 0: each its own).\n\n{markdown_table(head, rows)}"
    )


def _cell(one: Compared, metric: str) -> str:
    low, high = one[metric]["both"]
    text = f"{_signed(one[metric]['difference'])} ({_signed(low)} to {_signed(high)})"
    return text if verdict(one, metric) == "not told apart" else f"**{text}**"


def _signed(value: float, digits: int = 3) -> str:
    return f"{value:+.{digits}f}".replace("-", "−")
