"""Ship finished runs: their models to `checkpoints/`, with cards that hold the test numbers.

python -m studies.ship RUNS                         # copies RUNS/*_seed0/model to checkpoints/*
python -m studies.ship RUNS docs/results.json       # writes the cards again, tested

The first of several trainings ships; `studies.results` has the mean of all. Its
evaluation names either `checkpoints/NAME` or `RUNS/NAME_seed0/model`.
"""

import itertools
import json
import shutil
import sys
from pathlib import Path
from typing import Any

from neurosym_jax.models.disk import replace_card
from neurosym_jax.training.run import model_card

CHECKPOINTS = Path(__file__).resolve().parents[1] / "checkpoints"
FIRST = "_seed0"


def ship(runs: Path, rows: list[dict[str, Any]]) -> None:
    """Copy the models of all finished runs that do not ship yet, and write every card."""
    for run in sorted(path.parent for path in runs.glob(f"*{FIRST}/run.json")):
        folder = CHECKPOINTS / run.name.removesuffix(FIRST)
        if not folder.exists():
            shutil.copytree(run / "model", folder)
        names = {folder.name, run.name}
        tested = [
            row for row in rows if names & set(Path(row["checkpoint"] or "").parts)
        ]
        tests = {(row["dataset"], row["pred_len"]) for row in tested}
        untrained = [row for row in rows if row["checkpoint"] is None]
        baselines = [
            row for row in untrained if (row["dataset"], row["pred_len"]) in tests
        ]
        facts = json.loads((run / "run.json").read_text())
        replace_card(folder, model_card(facts, [*tested, *baselines]))
        print(f"{folder.name}: {len(tested)} test sets")


if __name__ == "__main__":
    reports = [json.loads(Path(name).read_text())["rows"] for name in sys.argv[2:]]
    ship(Path(sys.argv[1]), list(itertools.chain(*reports)))
