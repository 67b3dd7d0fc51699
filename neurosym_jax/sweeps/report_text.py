"""A report's JSON as Markdown that says in words what its intervals allow to be said."""

import json
from collections.abc import Sequence
from typing import Any

import numpy as np

from neurosym_jax.config import from_json, to_json
from neurosym_jax.evaluation.markdown import markdown_table
from neurosym_jax.evaluation.metrics import known_metric
from neurosym_jax.sweeps.learned_tables import agreement
from neurosym_jax.sweeps.table import format_sweep
from neurosym_jax.training.recipe import RECIPES, TrainConfig

__all__ = ["format_report"]

INTERVALS = """\
Differences are model less reference in the unit of the metric, on the same scenes with the same
noise and seed; below 0 the model is better, unless more of it is. In brackets 95 %: test scenes
resampled in blocks of as many start frames as a window has steps (neighbouring windows share most
of their steps), and the mean over seeds drawn from Student's t. The bootstrap over so few seeds,
given below, is too narrow to conclude from. `mean` weighs the test sets equally."""

Compared = dict[str, Any]


def format_report(data: dict[str, Any], figure: str, command: str) -> str:
    """The Markdown of `sweeps.report`'s JSON; `command` is the one that writes it."""
    compared: list[Compared] = data["comparisons"]
    references = list(dict.fromkeys(one["reference"] for one in compared))
    parts = ["# Weightings compared", _setting(data, command), "## The answer"]
    metrics: list[str] = data["metrics"]
    parts += [_answer(compared, metrics, reference) for reference in references]
    parts.append(_exceptions(compared, metrics))
    parts += [f"![Differences and their intervals]({figure})", "## The differences", INTERVALS]
    for reference in references:
        parts += [f"### Less {reference}", _differences(compared, metrics, reference)]
    parts += ["### What the uncertainty comes from", _sources(compared)]
    if data["learned"]:
        parts += ["## What was learned", _learned(data["learned"])]
    parts.append("## The errors")
    parts.append(format_sweep(data["rows"]))
    return "\n\n".join(part.rstrip() for part in parts) + "\n"


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
    where = "in the mean over test sets" if whole == "mean" else f"on {whole}"
    lines = [f"Against `{reference}`, {where}:", ""]
    for one in _of(compared, reference=reference, scene=whole):
        said = {metric: verdict(one, metric) for metric in metrics}
        kinds = list(dict.fromkeys(said.values()))
        words = (
            kinds[0]
            if len(kinds) == 1
            else "; ".join(
                f"{kind} in {', '.join(known_metric(m).title for m in metrics if said[m] == kind)}"
                for kind in kinds
            )
        )
        ade = one["joint_ade"]
        percent = 100 * ade["difference"] / ade["reference"]
        lines.append(
            f"- `{one['model']}`: joint ADE {_cell(ade)} m, {_signed(percent, 1)} %: {words}."
        )
    return "\n".join(
        [*lines, "", _bounds(_of(compared, reference=reference, scene=whole), metrics)]
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
        f"in {known_metric(metric).title}: {_cell(one[metric])} m."
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


def _differences(compared: Sequence[Compared], metrics: Sequence[str], reference: str) -> str:
    mine = _of(compared, reference=reference)
    head = ["model", "test set", *(known_metric(m).label for m in metrics)]
    rows = [
        [model, one["scene"], *(_cell(one[metric]) for metric in metrics)]
        for model in dict.fromkeys(one["model"] for one in mine)
        for one in _of(mine, model=model)
    ]
    return markdown_table(head, rows)


def _sources(compared: Sequence[Compared]) -> str:
    rows = []
    for one in _of(compared, scene=_whole(compared)):
        ade = one["joint_ade"]
        better = f"{sum(value < 0 for value in ade['of_seeds'])} of {len(ade['of_seeds'])}"
        spans = [_span(ade[name]) for name in ("scenes", "seeds", "both")]
        rows.append([one["model"], one["reference"], *spans, better])
    head = ["model", "less", "test scenes", "seeds (bootstrap)", "both", "seeds better"]
    table = markdown_table(head, rows)
    return f"Joint ADE; seeds better: on how many seeds the model was the better one.\n\n{table}"


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
        "Weights of the 16 states without a zero, less where they started: mean and spread over "
        "the states, and how the changes of two seeds correlate (1: every seed learns the same, "
        f"0: each its own).\n\n{markdown_table(head, rows)}"
    )


def _cell(of_metric: dict[str, Any]) -> str:
    return f"{_signed(of_metric['difference'])} ({_span(of_metric['both'])})"


def _span(interval: Sequence[float] | None) -> str:
    return "-" if interval is None else f"{_signed(interval[0])} to {_signed(interval[1])}"


def _signed(value: float, digits: int = 3) -> str:
    return f"{value:+.{digits}f}".replace("-", "−")
