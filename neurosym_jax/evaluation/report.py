"""An evaluation's rows as a table for people and as JSON for programs."""

import json
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from neurosym_jax.errors import InputError
from neurosym_jax.evaluation.metrics import known_metric
from neurosym_jax.runtime import files

__all__ = [
    "FORMAT",
    "check_replaceable",
    "format_table",
    "further_metrics",
    "metric_texts",
    "write_json",
]

FORMAT = 1


def format_table(rows: Sequence[dict[str, Any]]) -> str:
    """Rows grouped by scene and horizon, aligned, with both protocols labelled."""
    groups: dict[tuple[str, int, int], list[dict[str, Any]]] = {}
    for row in rows:
        groups.setdefault((row["scene"], row["obs_len"], row["pred_len"]), []).append(row)
    folder, short = _shortened([row["checkpoint"] for row in rows if row["checkpoint"]])
    names = {path: f"  {short[path]}" for path in short} | {None: ""}
    labels = [row["model"] + names[row["checkpoint"]] for row in rows]
    width = max(map(len, labels))
    cells = [_cells(row) for row in rows]
    # A title's first word stands above the others.
    heads = [["", *title.split(" ", 1)][-2:] for title in cells[0]]
    table = [*zip(*heads), *(list(of.values()) for of in cells)]
    widths = [max(map(len, column)) for column in zip(*table)]
    above, below, *lines = (
        f"  {label:{width}}  " + "  ".join(f"{cell:>{of}}" for cell, of in zip(line, widths))
        for line, label in zip(table, ["", "", *labels])
    )
    of_row = {id(row): line for row, line in zip(rows, lines)}
    blocks = [f"checkpoints in {folder}"] if folder else []
    for (scene, obs_len, pred_len), members in groups.items():
        counts = f"{members[0]['scenes']} scenes, {members[0]['agents']} agents"
        title = f"{scene}: {obs_len} steps observed, {pred_len} forecast; {counts}; metres"
        blocks.append("\n".join([title, above, below, *(of_row[id(row)] for row in members)]))
    about = dict.fromkeys(known_metric(name).about for name in rows[0]["metrics"])
    blocks.append("\n".join(filter(None, about)))
    return "\n\n".join(blocks)


def metric_texts(row: Mapping[str, Any]) -> dict[str, str]:
    """A row's metrics for people: `{"joint ADE": "0.431", "people in collision": "3.5 %"}`.

    A metric that nobody registered here, of a report from elsewhere, has its name for a title.
    """
    texts = {}
    for name, value in row["metrics"].items():
        metric = known_metric(name)
        texts[metric.title] = metric.text(value)
    return texts


def further_metrics(rows: Sequence[Mapping[str, Any]]) -> list[str]:
    """The metrics that all `rows` have beside those of their keys `joint` and `marginal`."""
    both = {f"{protocol}_{error}" for protocol in ("joint", "marginal") for error in ("ade", "fde")}
    # Rows of an earlier version, and no rows, have none.
    names = [name for row in rows[:1] for name in row.get("metrics", {}) if name not in both]
    return [name for name in names if all(row["metrics"].get(name) is not None for row in rows)]


def _cells(row: Mapping[str, Any]) -> dict[str, str]:
    return {
        **metric_texts(row),
        "k": str(row["samples"]),
        "forecasts a second": f"{row['forecasts_per_second']:.0f}",
        "latency in ms": f"{1000 * row['seconds']['latency']:.1f}",
    }


def _shortened(paths: Sequence[str]) -> tuple[str, dict[str, str]]:
    """The paths' common parent folder, if they have one, and each path relative to it."""
    try:
        folder = os.path.commonpath([os.path.dirname(path) for path in paths])
    except ValueError:  # no paths, or absolute and relative ones
        folder = ""
    return folder, {path: os.path.relpath(path, folder) if folder else path for path in paths}


def check_replaceable(path: Path) -> bool:
    """Whether a report is at `path` already.

    Raises:
        InputError: when `path` holds anything but a report, or cannot be written.
    """
    files.refuse_unwritable(path)
    if not path.exists():
        return False
    try:
        old = json.loads(path.read_text())
    except (OSError, ValueError):
        old = None
    if not isinstance(old, dict) or not {"format", "rows"} <= set(old):
        raise InputError(f"{path}: is not a report of ours, so it is not overwritten")
    return True


def write_json(path: Path, data: dict[str, Any]) -> None:
    """Write `data`; a file that is there is replaced only if it is such a report, and said so.

    Raises:
        InputError: when `path` holds anything else, or cannot be written.
    """
    if check_replaceable(path):
        print(f"replacing the report in {path}")
    files.write_json(path, data)
