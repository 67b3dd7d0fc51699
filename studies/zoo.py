"""The README's table of SGAN's published checkpoints, from an evaluation's JSON.

python evaluate.py --data DATA --checkpoint sgan-models/*.pt sgan-p-models/*.pt --json zoo.json
python -m studies.zoo zoo.json
"""

import itertools
import json
import sys
from pathlib import Path
from typing import Any

from neurosym_jax.evaluation.markdown import markdown_table
from studies.published import SCENES, SGAN_20V, SGAN_20VP

MODELS = {
    "SGAN, no pooling": ("SGAN-20V", SGAN_20V),
    "SGAN": ("SGAN-20VP", SGAN_20VP),
}
"""By the name that an evaluation gives them."""


def zoo_table(rows: list[dict[str, Any]]) -> str:
    """Joint best-of-k ADE / FDE in metres, ours above the published ones, as Markdown."""
    lines = []
    for pred_len, model in itertools.product((8, 12), MODELS):
        name, published = MODELS[model]
        ours = [_errors(rows, model, pred_len, scene) for scene in SCENES]
        theirs = ["{} / {}".format(*map("{:.2f}".format, published[pred_len][s])) for s in SCENES]
        lines += [[f"{name}, 8 + {pred_len}", "ours", *ours], ["", "published", *theirs]]
    for pred_len in (8, 12):
        ours = [_errors(rows, "constant velocity", pred_len, scene) for scene in SCENES]
        lines.append([f"constant velocity, 8 + {pred_len}", "ours", *ours])
    return markdown_table(["model, steps", "", *SCENES], lines)


def _errors(rows: list[dict[str, Any]], model: str, pred_len: int, scene: str) -> str:
    wanted = (model, pred_len, scene)
    for row in rows:
        if (row["model"], row["pred_len"], row["dataset"]) == wanted:
            return f"{row['joint_ade']:.2f} / {row['joint_fde']:.2f}"
    return "-"


if __name__ == "__main__":
    if len(sys.argv) != 2:
        sys.exit("usage: python -m studies.zoo zoo.json")
    print(zoo_table(json.loads(Path(sys.argv[1]).read_text())["rows"]))
