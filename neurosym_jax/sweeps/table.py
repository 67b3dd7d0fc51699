"""A sweep's rows as one table: mean over training seeds and its 95 % interval (Student's t)."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from neurosym_jax.evaluation.markdown import markdown_table
from neurosym_jax.evaluation.metrics import known_metric
from neurosym_jax.evaluation.paired import student_half
from neurosym_jax.evaluation.report import further_metrics

__all__ = ["format_sweep"]

Row = Mapping[str, Any]


def format_sweep(rows: Sequence[Row]) -> str:
    """Markdown: for each horizon and protocol a table of models by scenes, ADE / FDE in metres.

    The last column is the mean over scenes, taken seed by seed, where there are several.
    """
    blocks = []
    for lengths in dict.fromkeys((row["obs_len"], row["pred_len"]) for row in rows):
        members = [row for row in rows if (row["obs_len"], row["pred_len"]) == lengths]
        for protocol in ("joint", "marginal"):
            title = f"### {lengths[0]} steps observed, {lengths[1]} forecast: {protocol} best of k"
            pairs = [(row[protocol]["ade"], row[protocol]["fde"]) for row in members]
            blocks += [title, _table(members, pairs)]
        for metric in further_metrics(members):
            label = known_metric(metric).label
            title = f"### {lengths[0]} steps observed, {lengths[1]} forecast: {label}"
            values = [(row["metrics"][metric],) for row in members]
            blocks += [title, _table(members, values)]
    blocks.append(
        "ADE / FDE in metres, mean over training seeds ± half of the 95 % interval (Student's t). "
        "Joint: the best of k forecasts of the whole scene; marginal: each agent's own best."
    )
    return "\n\n".join(blocks) + "\n"


def _table(rows: Sequence[Row], values: Sequence[tuple[float, ...]]) -> str:
    """Models by test sets; `values` are what each of `rows` has in its cell."""
    scenes = list(dict.fromkeys(row["scene"] for row in rows))
    head = ["model", "k", "seeds", *scenes, *(["average"] if len(scenes) > 1 else [])]
    lines = []
    for model in dict.fromkeys(row["model"] for row in rows):
        # scene to seed to values; a baseline has no seed of training.
        found: dict[str, dict[Any, tuple[float, ...]]] = {scene: {} for scene in scenes}
        samples = 0
        for row, of_row in zip(rows, values):
            if row["model"] == model:
                seed = row["run"] and row["run"]["seed"]
                found[row["scene"]][seed] = of_row
                samples = row["samples"]
        seeds = {seed for of_scene in found.values() for seed in of_scene}
        cells = [_cell(list(found[scene].values())) for scene in scenes]
        if len(scenes) > 1:
            whole = [seed for seed in seeds if all(seed in found[scene] for scene in scenes)]
            means = [np.mean([found[scene][seed] for scene in scenes], axis=0) for seed in whole]
            cells.append(_cell([tuple(mean) for mean in means]))
        count = "-" if seeds == {None} else str(len(seeds))
        lines.append([model, str(samples), count, *cells])
    return markdown_table(head, lines)


def _cell(errors: Sequence[tuple[float, ...]]) -> str:
    if not errors:
        return "-"
    parts = []
    for values in zip(*errors):
        half = f" ± {student_half(values):.3f}" if len(values) > 1 else ""
        parts.append(f"{np.mean(values):.3f}{half}")
    return " / ".join(parts)
