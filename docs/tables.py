"""The README's table of SGAN's published checkpoints, from an evaluation's JSON.

python evaluate.py --data DATA --checkpoint sgan-models/*.pt sgan-p-models/*.pt --json zoo.json
python docs/tables.py zoo.json
"""

import json
import sys
from pathlib import Path
from typing import Any

SCENES = ("eth", "hotel", "univ", "zara1", "zara2")

PUBLISHED = {
    ("SGAN, no pooling", 8): ".58/1.13 .36/.71 .33/.70 .21/.42 .21/.42",
    ("SGAN", 8): ".57/1.14 .38/.73 .42/.79 .22/.43 .24/.48",
    ("SGAN, no pooling", 12): ".71/1.29 .48/1.02 .56/1.18 .34/.69 .31/.64",
    ("SGAN", 12): ".77/1.39 .43/.88 .75/1.50 .34/.68 .36/.73",
}
"""ADE/FDE in metres that SGAN's authors publish for their checkpoints, in the order of `SCENES`."""

NAMES = {"SGAN, no pooling": "SGAN-20V", "SGAN": "SGAN-20VP"}


def zoo_table(rows: list[dict[str, Any]]) -> str:
    """Joint best-of-k ADE / FDE in metres, ours above the published ones, as Markdown."""
    lines = [
        "| model, steps | | " + " | ".join(SCENES) + " |",
        "|---|---" + "|---" * len(SCENES) + "|",
    ]
    for (model, pred_len), published in PUBLISHED.items():
        ours = [_errors(rows, model, pred_len, scene) for scene in SCENES]
        theirs = ["{:.2f} / {:.2f}".format(*map(float, p.split("/"))) for p in published.split()]
        title = f"{NAMES[model]}, 8 + {pred_len}"
        lines.append(f"| {title} | ours | " + " | ".join(ours) + " |")
        lines.append("| | published | " + " | ".join(theirs) + " |")
    for pred_len in (8, 12):
        ours = [_errors(rows, "constant velocity", pred_len, scene) for scene in SCENES]
        lines.append(f"| constant velocity, 8 + {pred_len} | ours | " + " | ".join(ours) + " |")
    return "\n".join(lines)


def _errors(rows: list[dict[str, Any]], model: str, pred_len: int, scene: str) -> str:
    wanted = (model, pred_len, scene)
    for row in rows:
        if (row["model"], row["pred_len"], row["scene"]) == wanted:
            return "{ade:.2f} / {fde:.2f}".format(**row["joint"])
    return "-"


if __name__ == "__main__":
    if len(sys.argv) != 2:
        sys.exit("usage: python docs/tables.py zoo.json")
    print(zoo_table(json.loads(Path(sys.argv[1]).read_text())["rows"]))
