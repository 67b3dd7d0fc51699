"""`docs/distribution.csv`: energy scores of every model that ships and every baseline, by place.

WHAT="energy_score central_ade coverage_50 coverage_90 draw_collisions truth_collision_rate"
for T in 8 12; do
    HOW="--pred-len $T --no-figures --metrics $WHAT"
    python evaluate.py $HOW --data DATA --all --json R/eth_ucy_$T.json
    HOW="$HOW --model anchors_general_$T anchor_table_general_$T"
    HOW="$HOW --baselines constant_velocity_sampled"
    python evaluate.py $HOW --data THOR --json R/thor_$T.json
    names() { (cd $1 && ls $2* | sed 's/.txt$//; s/.csv$//'); }  # one test set of all recordings
    python evaluate.py $HOW --data CITR --fps 29.97 --test-on $(names CITR) --json R/citr_$T.json
    for F in stanford kept_back; do
        python evaluate.py $HOW --data MORE/$F --test-on $(names MORE/$F) --json R/${F}_$T.json
    done
    F=MORE/tests
    python evaluate.py $HOW --data $F --test-on $(names $F bo) --json R/corridors_$T.json
done
python -m studies.distribution R/*.json > docs/distribution.csv

DATA is ETH/UCY as SGAN arranges it, MORE what `studies.more_data` writes, THOR a folder
with THÖR and THÖR-MAGNI, CITR one with CITR's files of people alone
(`p2p_*/*_ped_filtered.csv` in OpenTraj's `datasets/CITR`). No network has learned the
recordings that it is tested on; the general ones learned other runs of the corridors.
On THÖR, MAGNI and Stanford they are those for one's own recordings, and of Stanford
kept back nothing was looked at before this test. SGAN and NeuroSyM ship for ETH/UCY
alone; those that learned from simulations are left out.

All are scored by 100 independent draws with the unbiased estimator; constant velocity has
one forecast. `†` marks a score that is significantly behind the best of its line (paired
over blocks of scenes, Holm, 5 %).
"""

import csv
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import polars as pl

from neurosym_jax.errors import InputError
from neurosym_jax.evaluation.compare import read_report
from studies.more_data import KEPT_BACK

PLACES = {
    **{name: name for name in ("eth", "hotel", "univ", "zara1", "zara2")},
    "THÖR 1": "CLiFF-LHMP_thor1_exp-1-run-2",
    "THÖR 3": "CLiFF-LHMP_thor3_exp-3-run-2",
    "MAGNI": "THOR-MAGNI_Scenario_5",
    "Stanford": "bookstore_1+",
    "kept back": "+".join(KEPT_BACK),
    "CITR": "bidirection_",
    "corridors": "bo-",
}
"""Places, and how the names of their test sets begin."""
MODELS = (
    "anchors",
    "anchor table",
    "constant velocity, sampled",
    "constant velocity",
    "SGAN",
    "NeuroSyM",
)
"""How the names of models begin, in the order of the columns."""
HEAD = ["place", "steps", *(f"energy score, {name}" for name in MODELS)]
HEAD += ["regions of 50 / 90 % hold", "% in collision, draws / truth"]
SIGNIFICANT = 0.05
SIMULATED = "_simulations_"
"""In the names of models that learned from simulations, which say nothing of real places."""


def table(rows: pl.DataFrame) -> list[list[str]]:
    """A line for each place and length that was evaluated.

    Raises:
        InputError: for scores by different numbers of draws.
    """
    counts = sorted(set(rows["draws"]))
    if len(counts) > 1:
        raise InputError(f"draws: scores by {counts} draws are not compared")
    lines = [HEAD]
    for steps in (8, 12):
        for place, start in PLACES.items():
            here = rows.filter(
                pl.col("dataset").str.starts_with(start), pl.col("pred_len") == steps
            )
            if len(here):
                lines.append([place, f"8 + {steps}", *_line(here)])
    return lines


def _line(rows: pl.DataFrame) -> list[str]:
    """Cells of one place, without models that learned from simulations.

    Raises:
        InputError: for two models of a kind.
    """
    values: dict[str, dict[str, Any]] = {}
    for row in rows.iter_rows(named=True):
        kind = _kind(row["model"])
        if SIMULATED in (row["checkpoint"] or ""):
            continue
        if kind in values:
            raise InputError(f"{row['dataset']}: two models are {kind}")
        values[kind] = row
    cells = [_score(values.get(name)) for name in MODELS]
    anchors = values["anchors"]
    regions = [f"{100 * anchors[f'coverage_{level}']:.0f}" for level in (50, 90)]
    collisions = [anchors["draw_collisions"], anchors["truth_collision_rate"]]
    shares = [f"{100 * share:.1f}" for share in collisions]
    return [*cells, " / ".join(regions), " / ".join(shares)]


def _kind(name: str) -> str:
    """The model's name in `MODELS`, without what tells apart several of a kind."""
    return name if name in MODELS else name.split(",")[0].split(" (")[0]


def _score(row: dict[str, float] | None) -> str:
    if row is None:
        return "-"
    half = (row["energy_score_high"] - row["energy_score_low"]) / 2
    p = row["energy_score_p"]
    mark = "†" if p is not None and p < SIGNIFICANT else ""
    return f"{row['energy_score']:.3f} ±{half:.3f}{mark}"


def main(reports: Sequence[str]) -> None:
    """Print the table of `reports`."""
    rows = pl.concat(
        [read_report(Path(path)) for path in reports], how="diagonal_relaxed"
    )
    csv.writer(sys.stdout, lineterminator="\n").writerows(table(rows))


if __name__ == "__main__":
    main(sys.argv[1:])
