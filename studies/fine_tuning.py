"""When does it pay to fine-tune `recommended` on the first minutes of a place? `docs/training.md`.

NPROC=1 python -m studies.fine_tuning DATA MORE THOR docs/fine_tuning.csv   # trains and tests
python -m studies.fine_tuning docs/fine_tuning.csv                          # the table

DATA is ETH/UCY as SGAN arranges it, MORE what `studies.more_data` writes, THOR a folder
with THÖR and THÖR-MAGNI. Of six places that the model has not learned, the first 10, 25
or 50 % of the recording are learned from (`prepare` keeps a part of them for
validation) and the last 40 % are tested on: from the model, from nothing where the part
is a half, and the model as it is. A seed is one training of each. The CSV grows row by
row, and what it has is not done again.
"""

import contextlib
import csv
import dataclasses
import itertools
import re
import tempfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import polars as pl

from neurosym_jax.data.recordings import recordings_in, windows_from
from neurosym_jax.data.tracks import Tracks
from neurosym_jax.data.windows import Windows, make_batches
from neurosym_jax.errors import InputError
from neurosym_jax.evaluation.intervals import student_half
from neurosym_jax.evaluation.markdown import markdown_table
from neurosym_jax.evaluation.scoring import score_forecaster
from neurosym_jax.forecasting.model import Model
from neurosym_jax.forecasting.model_folder import load_model
from neurosym_jax.models.anchors.recipe import AnchorRecipe
from neurosym_jax.training.loop import train_run
from neurosym_jax.training.preparation import prepare
from neurosym_jax.training.run import Run
from studies import print_or_run

PLACES = {
    "eth": "{data}/all/biwi_eth.txt",
    "hotel": "{data}/all/biwi_hotel.txt",
    "THÖR": "{thor}/CLiFF-LHMP_thor3_exp-3-run-2.csv",
    "MAGNI": "{thor}/THOR-MAGNI_Scenario_5.csv",
    "coupa": "{more}/tests/coupa_3.txt",
    "nexus": "{more}/tests/nexus_9.txt",
}
"""A file of each, of which the first recording counts; for eth and hotel `recommended` is the model
that has not learned them."""
SHARES, TESTED = (0.1, 0.25, 0.5), 0.6
"""Shares of a recording that are learned from, and the share from which on it is tested."""
SEEDS = range(5)
METRICS = ("energy_score", "joint_ade")
NOTHING = AnchorRecipe(steps=1000, validate_every=100)
FROM_MODEL = AnchorRecipe(steps=300, validate_every=50, learning_rate=1e-3)
HEAD = ("place", "share", "arm", "seed", "people", *METRICS)
TOO_SHORT = "too short"
"""The arm where a part has too few windows to learn from and to validate on."""


def split(tracks: Tracks, share: float) -> tuple[Tracks, Tracks]:
    """The first `share` of a recording's time, and what is tested on."""
    place = (tracks.stamp - tracks.stamp.min()) / np.ptp(tracks.stamp)
    return tracks.take(place < share), tracks.take(place >= TESTED)


def errors(model: Model, windows: Windows, seed: int) -> list[float]:
    """The metrics of a model, with the noise of a seed."""
    batches = make_batches(windows)
    result = score_forecaster(
        model.forecaster, model.params, batches, samples=20, seed=seed, metrics=METRICS
    )
    return [result.mean(metric) for metric in METRICS]


def rows_of(
    tracks: Tracks, model: Model, share: float, seed: int
) -> Iterator[tuple[str, int, list[float]]]:
    """Arm, people learned from, and metrics, of one part of a recording and one seed."""
    part, rest = split(tracks, share)
    lengths = model.config.obs_len, model.config.pred_len
    test = windows_from(rest, *lengths)
    yield "as it is", 0, errors(model, test, seed)
    try:
        learned, validated = prepare(model.config, NOTHING, part)
    except InputError:
        yield TOO_SHORT, 0, [np.nan, np.nan]
        return
    arms = [("fine-tuned", FROM_MODEL, model)]
    if share == SHARES[-1]:
        arms.append(("from nothing", NOTHING, None))
    for arm, recipe, init in arms:
        recipe = dataclasses.replace(recipe, seed=seed)
        run = Run(model.config, recipe, learned, validated, init=init)
        with tempfile.TemporaryDirectory() as folder, contextlib.redirect_stderr(None):
            trained = train_run(run, Path(folder), quiet=True)
        yield arm, learned.agents, errors(trained, test, seed)


def run_all(folders: dict[str, str], table: Path) -> None:
    """Do what `table` lacks, all places and shares of a seed before the next seed."""
    if not table.exists():
        table.write_text(",".join(HEAD) + "\n")
    with table.open() as file:
        finished = {
            (row["place"], row["share"], row["seed"]) for row in csv.DictReader(file)
        }
    for seed, place, share in itertools.product(SEEDS, PLACES, SHARES):
        if (place, str(share), str(seed)) in finished:
            continue
        tracks, *_ = recordings_in(PLACES[place].format(**folders))
        model = load_model("recommended", dataset=place)
        lines = [
            (place, share, arm, seed, people, *(f"{value:.6f}" for value in values))
            for arm, people, values in rows_of(tracks, model, share, seed)
        ]
        # All rows of a part at once: a table never holds some of them.
        with table.open("a", newline="") as file:
            csv.writer(file, lineterminator="\n").writerows(lines)
        print(*lines, sep="\n", flush=True)


def report(rows: pl.DataFrame) -> str:
    """The change of energy against the model as it is, per cent, by place; means of both metrics.

    Cells are means over seeds, the last rows means over places with their 95 %
    intervals.
    """
    columns = [*itertools.product(SHARES, ["fine-tuned"]), (SHARES[-1], "from nothing")]
    means = rows.group_by("place", "share", "arm").agg(
        pl.col(*METRICS).mean(), pl.col("people").max()
    )
    mean_of = {
        (row["place"], row["share"], row["arm"]): row for row in means.to_dicts()
    }

    def changes(metric: str, place: str) -> list[float]:
        """NaN where a part was too short, or is not done yet."""
        return [
            100
            * (mean_of[tuned][metric] / mean_of[place, share, "as it is"][metric] - 1)
            if (tuned := (place, share, arm)) in mean_of
            else np.nan
            for share, arm in columns
        ]

    lines = []
    for place in PLACES:
        people = mean_of.get((place, SHARES[-1], "fine-tuned"), {"people": "-"})[
            "people"
        ]
        cells = [f"{change:+.0f}" for change in changes("energy_score", place)]
        lines.append(
            [place, f"{people}", *("-" if cell == "+nan" else cell for cell in cells)]
        )
    for metric, title in zip(METRICS, ("energy", "joint ADE")):
        cells = []
        for column in zip(*(changes(metric, place) for place in PLACES)):
            values = [change for change in column if np.isfinite(change)]
            cells.append(
                f"{np.mean(values):+.0f} ± {student_half(values):.0f}"
                if values
                else "-"
            )
        lines.append([f"mean, {title}", "", *cells])
    head = ["place", "people in windows"]
    head += [f"{100 * share:.0f} %, {arm}" for share, arm in columns]
    table = re.sub(r" -(?=\d)", " −", markdown_table(head, lines, right=len(head) - 1))
    return f"{table}\n\n{rows['seed'].n_unique()} seeds; people in windows of the first 50 %."


if __name__ == "__main__":
    print_or_run(
        report,
        lambda *words: run_all(
            dict(zip(("data", "more", "thor"), words)), Path(words[3])
        ),
    )
