"""Compare a sweep's models, with intervals."""

from pathlib import Path

from tyro.conf import Positional

from neurosym_jax.training.sweep import compare_sweep

__all__ = ["run"]


def run(
    sweep: Positional[Path] = Path("runs/sweep"),
    against: tuple[str, ...] = (),
    pred_len: int | None = None,
    out: Path | None = None,
) -> None:
    """Compare a sweep's models with some of them, paired by seed and scene: Markdown and CSV.

    Args:
        sweep: Folder of the sweep.
        against: Models to compare with, by title or weighting; needed with more than two
            models.
        pred_len: Steps forecast, where the sweep has several.
        out: Markdown file, .csv beside it; default: report.md in the sweep's folder.
    """
    print(compare_sweep(sweep, against, pred_len=pred_len, out=out))
