"""`python -m neurosym_jax report`: what a sweep's weightings are worth, with what certainty."""

import dataclasses
from pathlib import Path
from typing import Any

import tyro

from neurosym_jax.errors import InputError
from neurosym_jax.evaluation.report import FORMAT, write_json
from neurosym_jax.sweeps.comparison import compare, one_horizon
from neurosym_jax.sweeps.errors import read_sweep
from neurosym_jax.sweeps.learned_tables import learned_changes
from neurosym_jax.sweeps.report_text import format_report

__all__ = ["ReportOptions", "report"]


@dataclasses.dataclass(frozen=True)
class ReportOptions:
    """Compare a sweep's models with references, paired: Markdown, JSON and a forest plot."""

    sweep: tyro.conf.Positional[Path]
    """Folder of the sweep."""
    against: tuple[str, ...] = ("ones", "SGAN")
    """The references: weightings, or SGAN."""
    pred_len: int | None = None
    """Steps forecast, where the sweep has several."""
    out: Path | None = None
    """Markdown file, .json and .png beside it; default: report.md in the sweep's folder."""


def report(options: ReportOptions) -> None:
    """Write the report that `options` ask for.

    Raises:
        InputError: for a folder without a sweep, or one that has not what is to be compared.
    """
    rows, errors = read_sweep(options.sweep)
    chosen = one_horizon(rows, options.pred_len)
    comparisons = compare(rows, errors, chosen, list(options.against))
    target = options.out or options.sweep / "report.md"
    if target.suffix != ".md":
        raise InputError(f"--out {target}: must end in .md")
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
    written = "" if options.out is None else f" --out {options.out}"
    against = " ".join(options.against)
    command = f"python -m neurosym_jax report SWEEP --against {against}{written}"
    text = format_report(data, target.with_suffix(".png").name, command)
    target.write_text(text)
    print(f"{text}\n{target}, {target.with_suffix('.json')}, {target.with_suffix('.png')}")


def _kept(row: dict[str, Any]) -> dict[str, Any]:
    """What a row says of errors, and of the run they are of, without where its files lie."""
    names = ("model", "scene", "obs_len", "pred_len", "samples", "scenes", "agents")
    errors = {name: row[name] for name in ("joint", "marginal", "metrics") if name in row}
    run = {name: row["run"][name] for name in ("model", "weighting", "recipe", "seed")}
    return {**{name: row[name] for name in names}, **errors, "run": run}
