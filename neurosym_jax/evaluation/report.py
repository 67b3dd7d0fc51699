"""An evaluation's rows as a table for people and as JSON for programs."""

import json
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
    width = max(len(_name(row)) for row in rows)
    head = (
        f"  {'':{width}}   joint best of k   marginal best       in   agents'    scene",
        f"  {'':{width}}      ADE     FDE     ADE     FDE  collision  k   per s       ms",
    )
    blocks = []
    for (scene, obs_len, pred_len), members in groups.items():
        counts = f"{members[0]['scenes']} scenes, {members[0]['agents']} agents"
        title = f"{scene}: {obs_len} steps observed, {pred_len} forecast; {counts}; metres"
        blocks.append("\n".join([title, *head, *(_line(row, width) for row in members)]))
    return "\n\n".join(blocks)


def _name(row: dict[str, Any]) -> str:
    return row["model"] if row["checkpoint"] is None else f"{row['model']}  {row['checkpoint']}"


def _line(row: dict[str, Any], width: int) -> str:
    joint, marginal, rate = row["joint"], row["marginal"], row["collision_rate"]
    collision = "-" if rate is None else f"{100 * rate:.1f} %"
    return (
        f"  {_name(row):{width}}  {joint['ade']:7.3f} {joint['fde']:7.3f}"
        f" {marginal['ade']:7.3f} {marginal['fde']:7.3f} {collision:>8} {row['samples']:>4}"
        f" {row['forecasts_per_second']:8.0f} {1000 * row['seconds']['latency']:7.1f}"
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
