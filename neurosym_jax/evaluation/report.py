"""An evaluation's rows as a table for people and as JSON for programs."""

import json
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from neurosym_jax.errors import InputError

__all__ = ["FORMAT", "check_replaceable", "format_table", "write_json"]

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
    head = (
        f"  {'':{width}}    joint best      marginal best  people in        forecasts  one scene",
        f"  {'':{width}}    ADE     FDE     ADE     FDE    collision    k  a second      in ms",
    )
    lines = {id(row): _line(row, label, width) for row, label in zip(rows, labels)}
    blocks = [f"checkpoints in {folder}"] if folder else []
    for (scene, obs_len, pred_len), members in groups.items():
        counts = f"{members[0]['scenes']} scenes, {members[0]['agents']} agents"
        title = f"{scene}: {obs_len} steps observed, {pred_len} forecast; {counts}; metres"
        blocks.append("\n".join([title, *head, *(lines[id(row)] for row in members)]))
    blocks.append(
        "joint: the best of k forecasts of the whole scene (SGAN's protocol); marginal: each\n"
        "agent's own best (most later papers). Best ADE and best FDE are chosen independently."
    )
    return "\n\n".join(blocks)


def _shortened(paths: Sequence[str]) -> tuple[str, dict[str, str]]:
    """The paths' common parent folder, if they have one, and each path relative to it."""
    try:
        folder = os.path.commonpath([os.path.dirname(path) for path in paths])
    except ValueError:  # no paths, or absolute and relative ones
        folder = ""
    return folder, {path: os.path.relpath(path, folder) if folder else path for path in paths}


def _line(row: dict[str, Any], label: str, width: int) -> str:
    joint, marginal, rate = row["joint"], row["marginal"], row["collision_rate"]
    collision = "-" if rate is None else f"{100 * rate:.1f} %"
    return (
        f"  {label:{width}}  {joint['ade']:5.3f}   {joint['fde']:5.3f}   {marginal['ade']:5.3f}"
        f"   {marginal['fde']:5.3f}  {collision:>11} {row['samples']:>4}"
        f" {row['forecasts_per_second']:9.0f} {1000 * row['seconds']['latency']:10.1f}"
    )


def check_replaceable(path: Path) -> bool:
    """Whether a report is at `path` already.

    Raises:
        InputError: when `path` holds anything but a report.
    """
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
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(json.dumps(data, indent=1) + "\n")
    except OSError as error:
        raise InputError(f"{path}: cannot be written ({error.strerror})") from None
