"""`docs/results.md` from two evaluations of what ships and of the published networks.

PUBLISHED is sgan-20v/*.pt sgan-20vp/*.pt, where `neurosym download sgan-checkpoints` put them;
`runs` has the trainings of docs/training.md.

python evaluate.py --data DATA --seeds 5 --metrics truth_collision_rate energy_score \\
    --checkpoint checkpoints/[ns]*_[ehuz]*_8_* runs/*_seed*/model PUBLISHED \\
    --json docs/results.json
python evaluate.py --data DATA --seeds 5 --metrics truth_collision_rate --protocol joint-metrics \\
    --checkpoint checkpoints/[ns]*_[ehuz]*_8_12 runs/*_8_12_seed*/model sgan-20v*/*_12_model.pt \\
    --json docs/results_joint_metrics.json
python -m studies.results docs/results.json docs/results_joint_metrics.json > docs/results.md
"""

import json
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from neurosym_jax.evaluation.markdown import markdown_table
from neurosym_jax.evaluation.summary import Line, Value, lines_of, means_of
from studies.published import ALL_WINDOWS, NEUROSYM, SCENES, SGAN_20V, SGAN_20VP
from studies.results_text import ALL, CHOSEN, COLLISIONS, HEAD
from studies.trainings import of_trainings

PUBLISHED = {
    "SGAN-20V, as printed": SGAN_20V,
    "SGAN-20VP, as printed": SGAN_20VP,
    "NeuroSyM, released logs, as printed": NEUROSYM,
}

NAMES = {
    "runs/sdd_": "{model}, more data",
    "sgan-20v/": "SGAN-20V, published networks",
    "sgan-20vp/": "SGAN-20VP, published networks",
    "checkpoints/": "{model}, ours",
    "runs/": "{model}, ours",
}
"""What a line is called, by where its model lies."""

JOINT = ("joint_ade", "joint_fde")

Cells = dict[str, str]
"""Texts by column."""


def document(rows: list[dict[str, Any]], all_windows: list[dict[str, Any]]) -> str:
    """The whole page."""
    rows, all_windows = of_trainings(rows), of_trainings(all_windows)
    head = ("what was chosen", "on what", "for which cells")
    blocks = {row["dataset"]: row["blocks"] for row in rows if row["pred_len"] == 12}
    facts = {
        "samples": max(row["samples"] for row in rows),
        "seeds": max(row["seeds"] for row in rows),
        "blocks": "8 + 12: " + ", ".join(f"{name} {count}" for name, count in blocks.items()),
        "chosen": markdown_table(head, CHOSEN),
        "means": _means(rows),
        "trainings": _trainings(rows),
    }
    parts = [HEAD.format(**facts)]
    for pred_len in (8, 12):
        mine = [row for row in rows if row["pred_len"] == pred_len]
        parts.append(f"## 8 + {pred_len} steps\n\nScenes/agents: {_sizes(mine)}.\n")
        printed = {name: of_length[pred_len] for name, of_length in PUBLISHED.items()}
        parts.append(f"Joint:\n\n{_errors(mine, 'joint', printed)}\n")
        parts.append(f"Marginal:\n\n{_errors(mine, 'marginal')}\n")
        parts.append(
            "Energy score of a scene's joint forecast, less is better "
            f"([evaluate.md](evaluate.md)):\n\n{_values(mine, 'energy_score')}\n"
        )
        parts.append(f"{COLLISIONS}\n{_collisions(mine)}\n")
    sizes = "/".join(
        str(row["scenes"]) for row in all_windows if row["model"] == _first(all_windows)
    )
    parts.append(f"{ALL.format(sizes=sizes)}\n{_errors(all_windows, 'joint', ALL_WINDOWS)}\n")
    parts.append(f"{COLLISIONS}\n{_collisions(all_windows)}")
    return "\n".join(parts)


def _trainings(rows: Sequence[Mapping[str, Any]]) -> str:
    """How many trainings each row beside constant velocity is of."""
    counts = {row["trainings"] for row in rows if (row["checkpoint"] or "").startswith("runs/")}
    return " to ".join(str(count) for count in sorted({min(counts), max(counts)}))


def _means(rows: Sequence[Mapping[str, Any]]) -> str:
    """Joint ADE / FDE of each model, over the scenes, by forecast steps."""
    lines = {
        pred_len: _lines([row for row in rows if row["pred_len"] == pred_len])
        for pred_len in (8, 12)
    }
    table = [
        [name, *(_mean(of_name.get(name, {})) for of_name in lines.values())] for name in lines[12]
    ]
    return markdown_table(["", *(f"8 + {pred_len}" for pred_len in lines)], table)


def _mean(of_scene: Mapping[str, Line]) -> str:
    errors = (f"{of_scene['mean'].values[error].mean:.3f}" for error in JOINT)
    return " / ".join(errors) if "mean" in of_scene else "-"


def _first(rows: Sequence[Mapping[str, Any]]) -> str:
    return rows[0]["model"]


def _sizes(rows: Sequence[Mapping[str, Any]]) -> str:
    tests = {row["dataset"]: f"{row['scenes']}/{row['agents']}" for row in rows}
    return "; ".join(f"{name} {size}" for name, size in tests.items())


def _name(line: Line) -> str:
    for place, name in NAMES.items():
        if line.checkpoint and line.checkpoint.startswith(place):
            return name.format(model=line.model)
    return line.model


def _lines(rows: Sequence[Mapping[str, Any]]) -> dict[str, dict[str, Line]]:
    """By name and by scene, `mean` among them."""
    lines = lines_of(rows)
    table: dict[str, dict[str, Line]] = {}
    for line in lines:
        table.setdefault(_name(line), {})[line.test_set.dataset] = line
    for line in means_of(lines):
        table[_name(line)]["mean"] = line
    return table


def _errors(
    rows: Sequence[Mapping[str, Any]],
    protocol: str,
    printed: Mapping[str, Mapping[str, Any]] | None = None,
) -> str:
    """ADE / FDE of all lines, those `printed` by others first."""
    table = {name: _printed(cells) for name, cells in (printed or {}).items()}
    for name, of_scene in _lines(rows).items():
        table[name] = {
            scene: " / ".join(_text(line.values[f"{protocol}_{part}"]) for part in ("ade", "fde"))
            for scene, line in of_scene.items()
        }
    return _table(table)


def _printed(cells: Mapping[str, Any]) -> Cells:
    texts = {
        scene: " / ".join(f"{error:.3f}".removesuffix("0") for error in of)
        for scene, of in cells.items()
        if of is not None
    }
    if len(texts) == len(cells):
        means = [sum(of[part] for of in cells.values()) / len(cells) for part in (0, 1)]
        texts["mean"] = f"{means[0]:.3f} / {means[1]:.3f}"
    return texts


def _values(rows: Sequence[Mapping[str, Any]], metric: str) -> str:
    return _table(
        {
            name: {scene: _text(line.values[metric]) for scene, line in of_scene.items()}
            for name, of_scene in _lines(rows).items()
        }
    )


def _collisions(rows: Sequence[Mapping[str, Any]]) -> str:
    """Shares, the truth's own first."""
    lines = _lines(rows)
    truth = next(iter(lines.values()))
    shares = {"the truth": (truth, "truth_collision_rate")}
    shares |= {name: (of_scene, "collision_rate") for name, of_scene in lines.items()}
    return _table(
        {
            name: {
                scene: f"{100 * line.values[metric].mean:.1f} %"
                for scene, line in of_scene.items()
                if line.values[metric].mean is not None
            }
            for name, (of_scene, metric) in shares.items()
        }
    )


def _text(value: Value) -> str:
    """Three digits, and half of the interval."""
    text = f"{value.mean:.3f}"
    if value.interval is not None:
        text += f" ±{(value.interval.high - value.interval.low) / 2:.3f}".replace("±0.", "±.")
    return f"**{text}**" if value.best else text


def _table(table: Mapping[str, Cells]) -> str:
    columns = (*SCENES, "mean")
    rows = [
        [name, *(cells.get(column, "-") for column in columns)] for name, cells in table.items()
    ]
    return markdown_table(["", *columns], rows)


if __name__ == "__main__":
    print(document(*(json.loads(Path(path).read_text())["rows"] for path in sys.argv[1:3])))
