"""How good are models at places where they have not learned? `left_out.md`, from nothing.

NPROC=1 python -m studies.places DATA MORE THOR OUT    # trains, tests, writes docs/left_out.csv
python -m studies.places > studies/pages/left_out.md   # from docs/left_out.csv; and its figure

A place is left out whole, with all its recordings, and models are trained on the
others: three of ETH/UCY's places are a recording or two each that data sets share, such
as the street Zara. DATA is ETH/UCY as SGAN arranges it, MORE what `studies.more_data`
writes, THOR a folder with three recordings of THÖR and THÖR-MAGNI. Models without the
corridors, which learned from ETH/UCY alone, are also tested on Stanford's scenes and on
THÖR, from which nothing is trained. OUT gets the runs and reports; a finished run is
not repeated.
"""

import os
import subprocess
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path

import polars as pl

from neurosym_jax.evaluation.compare import read_report
from neurosym_jax.evaluation.intervals import student_half
from neurosym_jax.evaluation.tables import markdown_table
from neurosym_jax.plotting import model_looks, save_figure
from neurosym_jax.plotting.style import COLUMN, add_legend, dress, new_figure

ROOT = Path(__file__).resolve().parents[1]
TABLE = ROOT / "docs" / "left_out.csv"
FIGURE = ROOT / "docs" / "figures" / "places.png"
MARKERS = "sDv^oX"
LENGTHS = ("--obs-len", "8", "--pred-len", "12")
PLACES = {
    "eth": ("biwi_eth",),
    "hotel": ("biwi_hotel",),
    "campus": ("students001", "students003", "uni_examples"),
    "Zara": ("crowds_zara01", "crowds_zara02", "crowds_zara03"),
    "corridors": (),
}
"""The places that are left out, and their recordings in ETH/UCY."""
RUNS = (
    ("anchors", 0),
    ("sgan", 0),
    ("anchor_table", 0),
    ("anchors", 1),
    ("anchors", 2),
)
RUNS += (("neurosym", 0),)
"""Models and seeds, in the order of training."""
BASELINES = ("constant_velocity", "constant_velocity_sampled")
METRICS = (
    "joint_ade",
    "joint_fde",
    "marginal_ade",
    "marginal_fde",
    "central_ade",
    "central_fde",
)
PARTS = {
    "Joint ADE / FDE": ("joint_ade", "joint_fde"),
    "Marginal ADE": ("marginal_ade",),
    "ADE of the central forecast": ("central_ade",),
}
"""Parts of the page, and what of `METRICS` they show."""
PAIRED = {"joint ADE, %": "joint_ade"}
# The first two paragraphs are written by hand from the numbers; check them when they
# change.
HEAD = """# Places left out whole

**By joint ADE `anchors` leads at seven of eight places, and is level with the anchor table on
Stanford's scenes. In the mean over places the error of SGAN is higher by 20 ± 10 %, of NeuroSyM by
15 ± 10 %, of the anchor table by 11 ± 7 %.** Joint errors reward spread. We [rank
models](../../docs/evaluate.md#metrics) by the energy score of the distribution, which was measured at
[twelve test sets](../../docs/results.md#the-distribution). `anchors` is the family of `recommended`.

On eth the table has the lower joint FDE. The central forecast of `anchors` is behind constant
velocity on the campus and on Stanford's scenes.

Errors in metres at 8 + 12, steps of 0.4 s, best of 20, of models that learned from nothing of
the place that they are tested at. "Campus" is UCY's university with three recordings, "Zara" the
street with three, "corridors" four runs of HERMES. Stanford (23 recordings), THÖR (two) and
THÖR-MAGNI (one) are tested with the models that learned from ETH/UCY alone. Anchors: the mean of
{seeds} seeds; all others: one training. Bold: the best of a column. eth is read with SGAN's
[wrong clock](../../docs/data.md#the-eth-recording).
"""
TAIL = """## Paired by place

Difference to `anchors` at each place, in per cent of anchors' value there: the mean over the
{count} places with Student's 95 % interval. Above 0 is worse than anchors.

{paired}

All means, FDE too, are in `docs/left_out.csv`. `python -m studies.places DATA MORE THOR
OUT` trains and tests all of it; its first lines say what the folders hold. The recipes were chosen
with pairs of ETH/UCY's data sets left out, and earlier forms of `anchors` were looked at on
Stanford's scenes, THÖR and HERMES. So none of the places is a fresh test."""


def train(
    data: Path, extra: Path, out: Path, place: str, model: str, seed: int
) -> None:
    """Train a model without a place, unless that is done."""
    run = out / place / f"{model}_seed{seed}"
    if not (run / "model").is_dir():
        files: dict[str, list[str]] = {"train": [], "val": []}
        for split, paths in files.items():
            for path in sorted((data / split).glob("*.txt")):
                if path.stem.removesuffix(f"_{split}") not in PLACES[place]:
                    paths.append(str(path))
        call(
            *(
                "train.py",
                "--family",
                model,
                *LENGTHS,
                "--seed",
                str(seed),
                "--out",
                str(run),
            ),
            *("--data", str(data), "--resume"),
            *("--train-on", *files["train"], "--validate-on", *files["val"]),
            *(() if place == "corridors" else ("--train-also", str(extra / "hermes"))),
        )


def test(
    folder: Path, names: list[str], report: Path, runs: list[Path]
) -> pl.DataFrame:
    """Rows of an evaluation on recordings as one test set, repeated where there are new runs."""
    tested = read_report(report)["checkpoint"].drop_nulls() if report.is_file() else ()
    if set(tested) != set(map(str, runs)):
        call(
            *(
                "evaluate.py",
                "--data",
                str(folder),
                "--test-on",
                *names,
                *LENGTHS,
                "--seeds",
                "1",
            ),
            *(
                "--model",
                *map(str, runs),
                "--baselines",
                *BASELINES,
                "--json",
                str(report),
            ),
            *("--metrics", "energy_score", "central_ade", "central_fde"),
        )
    return read_report(report).with_columns(dataset=pl.lit(report.stem))


def page(means: pl.DataFrame) -> str:
    """The page, of a row for each model and place."""
    places = means["dataset"].unique(maintain_order=True).to_list()
    parts = [
        f"## {title}\n\n{_table(means, metrics, places)}\n"
        for title, metrics in PARTS.items()
    ]
    errors = {
        model: rows.select(PAIRED.values()).to_numpy()
        for (model,), rows in means.group_by("model", maintain_order=True)
    }
    anchors = errors.pop("anchors")
    paired = []
    for model, others in errors.items():
        percent = 100 * (others / anchors - 1)
        if len(percent):
            cells = [f"{x.mean():+.1f} ± {student_half(x):.1f}" for x in percent.T]
            paired.append([model, *cells])
    seeds = means.filter(model="anchors")["trainings"].min()
    tail = TAIL.format(count=len(places), paired=markdown_table(["", *PAIRED], paired))
    return "\n".join([HEAD.format(seeds=seeds), *parts, tail])


def joint_errors(means: pl.DataFrame, names: Mapping[str, str]) -> str:
    """A table of joint ADE, in which models are called by `names`."""
    places = means["dataset"].unique(maintain_order=True).to_list()
    named = means.with_columns(pl.col("model").replace(names))
    return _table(named, ("joint_ade",), places)


def draw(means: pl.DataFrame, path: Path = FIGURE) -> Path:
    """Draw joint ADE: a line for each place, a point on it for each model."""
    named = means.with_columns(pl.col("model").replace({"anchors": "recommended"}))
    places = named["dataset"].unique(maintain_order=True).to_list()
    models = named["model"].unique(maintain_order=True).to_list()
    figure, ((axes,),) = new_figure(1.35 * COLUMN, 3.9)
    looks = model_looks(models)
    for marker, model in zip(MARKERS, models):
        rows = named.filter(pl.col("model") == model)
        line = [places.index(place) for place in rows["dataset"]]
        point = {"color": looks[model]["color"], "marker": marker, "linestyle": "none"}
        size = 8 if model == "recommended" else 5
        axes.plot(rows["joint_ade"], line, **point, markersize=size, label=model)
    axes.set_yticks(range(len(places)), places)
    axes.invert_yaxis()
    axes.set_xlim(left=0)
    title = "Error at places that no model has seen"
    dress(axes, "joint ADE [m], 8 + 12 steps; left is better", "", title)
    return save_figure(add_legend(figure, axes), path)


def _table(means: pl.DataFrame, metrics: Sequence[str], places: list[str]) -> str:
    """A row for each model, a column for each place; the least of a metric there is bold."""
    values = means.with_columns(
        pl.col(metrics).map_elements("{:.3f}".format, pl.String)
    )
    best = values.group_by("dataset").agg(pl.col(metrics).min()).rows_by_key("dataset")
    lines = []
    for (model,), rows in values.group_by("model", maintain_order=True):
        cells = []
        for place, *texts in rows.select("dataset", *metrics).iter_rows():
            marked = (
                f"**{t}**" if t == b else t for t, b in zip(texts, best[place][0])
            )
            cells.append(" / ".join(marked))
        lines.append([model, *cells])
    return markdown_table(["", *places], lines)


def call(*command: str) -> None:
    """Run one of the project's commands with one thread, its words on our standard error."""
    environment = {**os.environ, "NPROC": "1"}
    subprocess.run(
        [sys.executable, *command],
        cwd=ROOT,
        env=environment,
        stdout=sys.stderr,
        check=True,
    )


def run() -> None:
    """Train what is not trained yet, test all, write the means of each model at each place."""
    data, extra, thor, out = (Path(name).resolve() for name in sys.argv[1:])
    for model, seed in RUNS:
        for place in PLACES:
            train(data, extra, out, place, model, seed)
    tests = {place: (data, names, place) for place, names in PLACES.items() if names}
    corridors = [path.stem for path in (extra / "tests").glob("bo*.txt")]
    tests["corridors"] = extra / "tests", corridors, "corridors"
    tests["Stanford"] = (
        extra / "stanford",
        [path.stem for path in (extra / "stanford").iterdir()],
        "",
    )
    tests["THÖR"] = (
        thor,
        ["CLiFF-LHMP_thor1_exp-1-run-2", "CLiFF-LHMP_thor3_exp-3-run-2"],
        "",
    )
    tests["MAGNI"] = thor, ["THOR-MAGNI_Scenario_5"], ""
    rows = []
    for name, (folder, recordings, place) in tests.items():
        runs = sorted((out / (place or "corridors")).glob("*/model"))
        rows.append(test(folder, sorted(recordings), out / f"{name}.json", runs))
    models = pl.concat(rows, how="diagonal_relaxed").group_by(
        "dataset", "model", maintain_order=True
    )
    means = models.agg(pl.col(METRICS).mean(), trainings=pl.len())
    means.write_csv(TABLE, float_precision=5)


if __name__ == "__main__":
    if sys.argv[1:]:
        run()
    else:
        print(page(pl.read_csv(TABLE)))
        draw(pl.read_csv(TABLE))
