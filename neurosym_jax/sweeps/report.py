"""What a sweep's models are worth, with what certainty: a page, its data and its figure."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from neurosym_jax.errors import InputError
from neurosym_jax.evaluation.report import FORMAT, write_json
from neurosym_jax.runtime.files import refuse_unwritable, write_text
from neurosym_jax.sweeps.comparison import compare, one_horizon
from neurosym_jax.sweeps.errors import read_sweep
from neurosym_jax.sweeps.learned_tables import learned_changes
from neurosym_jax.sweeps.report_text import format_differences, format_report
from neurosym_jax.sweeps.table import format_sweep

__all__ = ["write_report"]


def write_report(
    sweep: Path,
    against: Sequence[str] = ("ones", "SGAN"),
    *,
    pred_len: int | None = None,
    out: Path | None = None,
) -> str:
    """Compare a sweep's models with references: Markdown; CSV, JSON and a forest plot beside it.

    Args:
        sweep: folder of the sweep.
        against: the references: weightings, or SGAN.
        pred_len: steps forecast, where the sweep has several.
        out: the Markdown's file; default: report.md in the sweep's folder.

    Returns:
        The Markdown, the errors, and a line of the files that were written.

    Raises:
        InputError: for a folder without a sweep, or one that has not what is to be compared.
    """
    target = out or sweep / "report.md"
    if target.suffix != ".md":
        raise InputError(f"--out {target}: must end in .md")
    refuse_unwritable(target)
    rows, errors = read_sweep(sweep)
    chosen = one_horizon(rows, pred_len)
    comparisons = compare(rows, errors, chosen, list(against))
    data: dict[str, Any] = {
        "format": FORMAT,
        "training": rows[chosen[0]]["run"]["training"],
        "rows": [_kept(rows[index]) for index in chosen],
        "metrics": list(comparisons[0].difference.metrics),
        "comparisons": [comparison.to_json() for comparison in comparisons],
        "learned": learned_changes([rows[index] for index in chosen]),
    }
    write_json(target.with_suffix(".json"), data)
    from neurosym_jax.plotting.forest import plot_forest

    plot_forest(data["comparisons"], target.with_suffix(".png"))
    written = "" if out is None else f" --out {out}"
    command = f"python -m neurosym_jax report SWEEP --against {' '.join(against)}{written}"
    text = format_report(data, target.stem, command)
    write_text(target, text)
    write_text(target.with_suffix(".csv"), format_differences(data))
    files = ", ".join(
        str(target.with_suffix(ending)) for ending in (".md", ".csv", ".json", ".png")
    )
    return f"{text}\n{format_sweep(data['rows'])}\n\n{files}"


def _kept(row: dict[str, Any]) -> dict[str, Any]:
    """What a row says of errors, and of the run they are of, without where its files lie."""
    names = ("model", "scene", "obs_len", "pred_len", "samples", "scenes", "agents")
    errors = {name: row[name] for name in ("joint", "marginal", "metrics") if name in row}
    run = {name: row["run"][name] for name in ("model", "weighting", "recipe", "seed")}
    return {**{name: row[name] for name in names}, **errors, "run": run}
