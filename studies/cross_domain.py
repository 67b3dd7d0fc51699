"""`docs/cross_domain.md` from evaluations of models on other people than those they learned from.

MODELS="$(ls -d checkpoints/*_zara1_* checkpoints/*_simulations_*)"
ALL="$MODELS $(ls -d checkpoints/*_general_*)"
python evaluate.py --data THOR --checkpoint $ALL --json docs/cross_domain/thor.json
python evaluate.py --data MORE/tests --checkpoint $ALL --json docs/cross_domain/more.json
python evaluate.py --data DATA --dataset zara1 --checkpoint $MODELS \\
    --json docs/cross_domain/zara1.json
for scene in all-forward cross-path; do
    python evaluate.py --dataset $scene --checkpoint $ALL --json docs/cross_domain/$scene.json
done
python -m studies.cross_domain docs/cross_domain/*.json > docs/cross_domain.md
"""

import json
import sys
from pathlib import Path
from typing import Any

import numpy as np

from neurosym_jax.evaluation.markdown import markdown_table
from studies.more_data import STANFORD_TESTED
from studies.weighting.data import TESTED

TESTS = {
    "zara1": ("zara1",),
    "THÖR 1": ("CLiFF-LHMP_thor1_exp-1-run-2",),
    "THÖR 3": ("CLiFF-LHMP_thor3_exp-3-run-2",),
    "MAGNI": ("THOR-MAGNI_Scenario_5",),
    "Stanford": STANFORD_TESTED,
    "corridors": TESTED,
    "scenario A": ("all-forward",),
    "scenario B": ("cross-path",),
}
"""What test sets are called here, and of which scenes they are the mean."""

TRAINED = {
    "zara1": ("ETH/UCY without zara1", ("zara1",)),
    "general": ("all of ETH/UCY, corridors", ("zara1", "corridors")),
    "simulations": ("both scenarios", ("scenario A", "scenario B")),
}
"""By a part of the checkpoint's name: what it was trained on, and the tests of its own domain."""

HEAD = """# Other domains

**On recordings from elsewhere `anchors` has the least joint ADE of all that did not learn there,
but for Stanford's at 8 + 12 and scenario A at 8 + 8, where the anchor table is level.** Most of its
leads are smaller than their intervals. Models that learned from simulated people fail on real ones,
with errors up to seven times constant velocity's: train on recordings of your own place if you can.

Joint ADE in metres, best of {samples}, steps of 0.4 s. No model saw the recording that it is tested
on. _Italic_: a test of the domain that the model learned from. Bold: the best of a column. Constant
velocity makes one forecast.
"""

TAIL = """
<details markdown="1">
<summary>How this was measured</summary>

One training each; seed {seed}. The commands are in the first lines of `studies/cross_domain.py`.
THÖR 1 and 3 are `thor1_exp-1-run-2` and `thor3_exp-3-run-2` as CLiFF-LHMP gives them; MAGNI is
Scenario 5 of THÖR-MAGNI; Stanford is the mean of three recordings of the Stanford drone scenes,
corridors of four runs of HERMES (`studies.more_data`). [Places left out whole](left_out.md) has the
same corridors, but 23 other recordings of Stanford. Scenarios A and B are the simulated all-forward
and cross-path. FDE stands in the JSON files beside this page.

Scenes / people at 8 + 8: {counted}.

</details>"""


def document(rows: list[dict[str, Any]]) -> str:
    """The whole page."""
    # The baseline that `evaluate` adds is the shipped table of all data, which stands
    # here already.
    rows = [row for row in rows if row["checkpoint"] or row["model"] != "anchor table"]
    parts = [HEAD.format(samples=max(row["samples"] for row in rows))]
    for pred_len in (8, 12):
        mine = [row for row in rows if row["pred_len"] == pred_len]
        parts.append(f"## 8 + {pred_len} steps\n\n{_table(mine)}\n")
    sizes = {
        row["dataset"]: np.array([row["scenes"], row["agents"]])
        for row in rows
        if row["pred_len"] == 8
    }
    counts = {
        test: sum(sizes[member] for member in members)
        for test, members in TESTS.items()
    }
    counted = ", ".join(
        f"{test} {scenes} / {agents}" for test, (scenes, agents) in counts.items()
    )
    return "\n".join(
        [*parts, TAIL.strip("\n").format(seed=rows[0]["seed"], counted=counted)]
    )


def _table(rows: list[dict[str, Any]]) -> str:
    """Models as rows, tests as columns."""
    reports: dict[tuple[str, str], dict[str, float]] = {}
    home: dict[tuple[str, str], tuple[str, ...]] = {}
    for row in rows:
        trained, own = _trained(row["checkpoint"])
        home[row["model"], trained] = own
        reports.setdefault((row["model"], trained), {})[row["dataset"]] = row[
            "joint_ade"
        ]
    table = {
        key: {
            test: f"{np.mean([errors[member] for member in members]):.2f}"
            for test, members in TESTS.items()
            if set(members) <= set(errors)
        }
        for key, errors in reports.items()
    }
    order = ["", *(trained for trained, _ in TRAINED.values())]
    tests = [test for test in TESTS if any(test in cells for cells in table.values())]
    best = {
        test: min(cells[test] for cells in table.values() if test in cells)
        for test in tests
    }
    lines = []
    for key in sorted(table, key=lambda key: (order.index(key[1]), key[0])):
        cells = []
        for test in tests:
            cell = table[key].get(test, "-")
            cell = f"**{cell}**" if cell == best[test] else cell
            cells.append(
                f"_{cell}_" if test in home[key] and test in table[key] else cell
            )
        lines.append([*key, *cells])
    return markdown_table(["", "trained on", *tests], lines, right=len(tests))


def _trained(checkpoint: str | None) -> tuple[str, tuple[str, ...]]:
    """What a checkpoint was trained on, and the tests of its own domain."""
    if checkpoint is None:
        return "", ()
    return next(
        domain
        for name, domain in TRAINED.items()
        if f"_{name}_" in Path(checkpoint).name
    )


if __name__ == "__main__":
    reports = [json.loads(Path(name).read_text())["rows"] for name in sys.argv[1:]]
    print(document([row for rows in reports for row in rows]))
