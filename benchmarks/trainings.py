"""Seconds of whole trainings as models ship, and the figure of errors against them.

    python -m benchmarks trainings --data DATA --json docs/benchmarks.json
    python -m benchmarks.trainings docs/figures/seconds.png

The trainings are for zara1, 8 + 12, one each. That of the released code, which has
pooling, is its 8,400 iterations times what one takes here at 8 + 8 (`python -m
benchmarks training --reference SGAN`). The errors are those of docs/results.json, means
over the five data sets.
"""

import dataclasses
import json
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import polars as pl

from benchmarks.timing import OURS, row

MODELS = {"anchor_table": "anchor table", "anchors": "anchors", "sgan": "SGAN"}
RELEASED, ITERATIONS = "SGAN-20VP, released code", 8400
DOCS = Path(__file__).parents[1] / "docs"


def measure(options: Any) -> dict[str, Any]:
    """See the module."""
    from neurosym_jax.data.recordings import open_source
    from neurosym_jax.models.forecaster import forecaster_of
    from neurosym_jax.training.loop import train
    from neurosym_jax.training.run import make_config, recipes_of

    source, table = open_source(options.data), []
    parts = [source.recordings("zara1", part) for part in ("train", "val")]
    for model, title in MODELS.items():
        config = make_config(model, pred_len=12)
        recipe = next(iter(recipes_of(type(forecaster_of(config))).values()))
        if model == "sgan":
            recipe = dataclasses.replace(recipe, steps=5000)
        with tempfile.TemporaryDirectory() as folder:
            start = time.perf_counter()
            train(*parts, Path(folder, "run"), config=config, recipe=recipe)
            table.append(row(title, OURS, [time.perf_counter() - start]))
    return {"title": "whole trainings, zara1, 8 + 12", "rows": table}


def draw(path: Path) -> None:
    """Draw errors against seconds, each network a point."""
    from neurosym_jax.evaluation.compare import read_report
    from neurosym_jax.plotting.style import (
        COLUMN,
        SMALL,
        dress,
        model_looks,
        new_figure,
        save_figure,
    )

    rows_by_benchmark = json.loads((DOCS / "benchmarks.json").read_text())["benchmarks"]
    seconds = {
        row["case"]: row["median"] for row in rows_by_benchmark["trainings"]["rows"]
    }
    step = next(
        row["median"]
        for row in rows_by_benchmark["training"]["rows"]
        if row["who"] == "original"
    )
    seconds[RELEASED] = ITERATIONS * step
    rows = read_report(DOCS / "results.json").filter(pred_len=12)
    checkpoint = pl.col("checkpoint").fill_null("")
    rows = rows.filter(~checkpoint.str.contains("sgan-20v/|^sgan_")).with_columns(
        model=pl.when(checkpoint.str.contains("sgan-20vp/"))
        .then(pl.lit(RELEASED))
        .otherwise("model")
    )
    kinds = ("joint_ade", "marginal_ade")
    # Five trainings of a data set count as one.
    means = rows.group_by("model", "dataset").agg(pl.col(kinds).mean())
    means = means.group_by("model").agg(pl.col(kinds).mean())
    figure, grid = new_figure(COLUMN, 4.4, rows=2, sharex=True)
    looks = model_looks([*seconds, "constant velocity"])
    for (axes,), kind in zip(grid, kinds):
        errors = {name: means.filter(model=name)[kind].item() for name in looks}
        for name, took in seconds.items():
            # Hollow: the time is not measured.
            fill = "none" if name == RELEASED else "full"
            axes.plot(
                took, errors[name], "o", color=looks[name]["color"], fillstyle=fill
            )
            words: dict[str, Any] = {"textcoords": "offset points", "size": SMALL}
            side = "right" if name == RELEASED else "center"
            at = (0, -13 if name == "anchors" else 6)
            text = "recommended" if name == "anchors" else name
            axes.annotate(text, (took, errors[name]), at, ha=side, **words)
        constant = errors["constant velocity"]
        axes.axhline(constant, **looks["constant velocity"], linewidth=0.8)
        axes.annotate("constant velocity", (5, constant), (0, -8), **words)
        axes.set(xscale="log", xlim=(4, 1e5), ylim=(0.15, 0.57))
        dress(axes, y_label=f"{kind.split('_')[0]} ADE, m")
    grid[-1, 0].set_xlabel("seconds of training on two cores")
    save_figure(figure, path)


if __name__ == "__main__":
    draw(Path(sys.argv[1]))
