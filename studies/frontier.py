"""Joint against marginal error of anchors, by the weight of the marginal error in the loss.

    for weight in 0 0.25 3; do
        neurosym sweep --model anchors --dataset eth hotel univ zara1 zara2 --data DATA \\
            --pred-len 12 --seed 0 --set marginal_weight=$weight --out OUT/$weight
    done
    python -m studies.frontier OUT/*/sweep.json

writes docs/frontier.csv, means over the data sets at 8 + 12, and draws
docs/figures/frontier.png. The default weight and the other networks are from
docs/results.json, of one training each.
"""

import sys
from collections.abc import Sequence
from pathlib import Path

import polars as pl

from neurosym_jax.evaluation.report import read_report
from neurosym_jax.models.anchors.recipe import AnchorRecipe
from neurosym_jax.plotting.style import (
    SMALL,
    dress,
    model_looks,
    new_figure,
    save_figure,
)

__all__ = ["draw", "errors"]

DOCS = Path(__file__).parents[1] / "docs"
ERRORS = ("joint_ade", "joint_fde", "marginal_ade", "marginal_fde")
DEFAULT = AnchorRecipe().marginal_weight
OTHERS = ("anchor table", "SGAN")


def errors(sweeps: Sequence[Path], results: pl.DataFrame) -> pl.DataFrame:
    """Mean errors by `model` and `marginal_weight`; reads the weight from each sweep's folder."""
    first = results.filter(
        pl.col("checkpoint").str.contains("anchors_.*seed0|^checkpoints/"), pred_len=12
    )
    parts = [(None, first.filter(pl.col("model").is_in(OTHERS)))]
    parts += [(DEFAULT, first.filter(model="anchors"))]
    for path in sweeps:
        parts.append(
            (float(path.parent.name), read_report(path).filter(model="anchors"))
        )
    means = [
        rows.group_by("model")
        .agg(pl.len().alias("data sets"), pl.col(ERRORS).mean())
        .with_columns(marginal_weight=pl.lit(weight, pl.Float64))
        for weight, rows in parts
    ]
    return pl.concat(means).sort("model", "marginal_weight")


def draw(means: pl.DataFrame, path: Path) -> None:
    """Draw marginal against joint ADE: anchors as a line, the others as points."""
    figure, grid = new_figure(4.2, 2.8)
    axes, looks = grid[0, 0], model_looks(["anchors", *OTHERS])
    for model, look in looks.items():
        rows = means.filter(model=model)
        joint, marginal = rows["joint_ade"], rows["marginal_ade"]
        axes.plot(joint, marginal, "o-", color=look["color"], markersize=4)
        for x, y, weight in zip(joint, marginal, rows["marginal_weight"]):
            text = model if weight is None else f"anchors, weight {weight:g}"
            text += ", default" * (weight == DEFAULT)
            axes.annotate(text, (x, y), (6, 2), textcoords="offset points", size=SMALL)
    axes.set(xlim=(0.315, 0.395), ylim=(0.18, 0.3))
    dress(axes, "joint ADE, m", "marginal ADE, m")
    save_figure(figure, path)


if __name__ == "__main__":
    table = errors(
        [Path(path) for path in sys.argv[1:]], read_report(DOCS / "results.json")
    )
    table.write_csv(DOCS / "frontier.csv", float_precision=4)
    draw(table, DOCS / "figures" / "frontier.png")
