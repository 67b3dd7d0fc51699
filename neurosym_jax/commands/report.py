"""Compare a sweep's models, with intervals."""

import dataclasses
from pathlib import Path

import tyro

from neurosym_jax.training.sweep import compare_sweep

__all__ = ["Options", "run"]


@dataclasses.dataclass(frozen=True)
class Options:
    """Compare a sweep's models with one of them, paired by seed and scene: Markdown and CSV."""

    sweep: tyro.conf.Positional[Path]
    """Folder of the sweep."""
    against: str | None = None
    """Model to compare with, by title or weighting; needed with more than two models."""
    pred_len: int | None = None
    """Steps forecast, where the sweep has several."""
    out: Path | None = None
    """Markdown file, .csv beside it; default: report.md in the sweep's folder."""


def run(options: Options) -> None:
    """Write and print the report that `options` ask for; see `training.sweep.compare_sweep`."""
    print(compare_sweep(options.sweep, options.against, pred_len=options.pred_len, out=options.out))
