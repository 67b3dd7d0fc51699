"""`docs/distribution.csv`: what draws from the distribution of `recommended` are worth, by place.

WHAT="energy_score central_ade coverage_50 coverage_90 draw_collisions truth_collision_rate"
for T in 8 12; do
    HOW="--pred-len $T --no-figures --metrics $WHAT"
    python evaluate.py $HOW --data DATA --checkpoint recommended --json R/eth_ucy_$T.json
    HOW="$HOW --checkpoint anchors_general_$T anchor_table_general_$T"
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
kept back nothing was looked at before this test.
"""

import csv
import sys
from collections.abc import Sequence
from pathlib import Path

import polars as pl

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
MODELS = ("anchors", "anchor table", "constant velocity, sampled")
HEAD = ["place", "steps", *(f"energy score, {name}" for name in MODELS)]
HEAD += ["regions of 50 / 90 % hold", "% in collision, draws / truth"]


def table(rows: pl.DataFrame) -> list[list[str]]:
    """A line for each place and length."""
    lines = [HEAD]
    for steps in (8, 12):
        for place, start in PLACES.items():
            mine = rows.filter(
                pl.col("dataset").str.starts_with(start), pl.col("pred_len") == steps
            )
            values = {row["model"]: row for row in mine.iter_rows(named=True)}
            anchors = values["anchors"]
            regions = (100 * anchors[f"coverage_{level}"] for level in (50, 90))
            collisions = (
                100 * anchors[name]
                for name in ("draw_collisions", "truth_collision_rate")
            )
            lines.append([
                place,
                f"8 + {steps}",
                *(_score(values[name]) for name in MODELS),
                " / ".join(f"{value:.0f}" for value in regions),
                " / ".join(f"{value:.1f}" for value in collisions),
            ])  # fmt: skip
    return lines


def _score(row: dict[str, float]) -> str:
    half = (row["energy_score_high"] - row["energy_score_low"]) / 2
    return f"{row['energy_score']:.3f} ±{half:.3f}"


def main(reports: Sequence[str]) -> None:
    """Print the table of `reports`."""
    rows = pl.concat(
        [read_report(Path(path)) for path in reports], how="diagonal_relaxed"
    )
    csv.writer(sys.stdout, lineterminator="\n").writerows(table(rows))


if __name__ == "__main__":
    main(sys.argv[1:])
