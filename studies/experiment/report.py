"""The report of the experiment: tables, figures, and what the robot paper printed."""

import dataclasses
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from neurosym_jax.evaluation.markdown import markdown_table
from neurosym_jax.runtime.files import write_json, write_text
from neurosym_jax.runtime.process import run_environment
from neurosym_jax.simulation.scenarios import Scenario
from neurosym_robot.online.replay import STRAIGHT
from studies.experiment.figures import write_figures
from studies.experiment.results import FAULTS, MODELS, Recording

__all__ = ["write_report"]

NAMES: dict[Scenario, str] = {"all-forward": "A, all-forward", "cross-path": "B, cross-path"}
HEAD = """# The robot experiment, on simulated people

**The whole chain works, from a tracker's messages to scored forecasts: stitching raises IDF1 from
{raw:.2f} to {mended:.2f}, and a forecast takes {latency:.0f} ms.** The robot paper's experiment
(two people, two scenarios, two recordings each) is repeated with simulated people. The numbers show
that the chain works and what it costs, not which network is better on real people.

    python -m studies.experiment --out results/experiment

In scenario A two people walk side by side to the end of a room and back; in B they cross. A tracker
at 10 Hz sees them with {noise:.0f} cm of noise, and loses each of them every 20 s on average. Its
messages go into bags and come back frame by frame through stitching, prediction and analytics.

## Errors"""

NOTE = """Metres. ADE / FDE: the published forecast, which is the central forecast. Best of k: the
best sample for both people together. Summed: over people and steps, as in the paper's tables.
Consecutive forecasts overlap.

The paper printed, with real people and 3 to 7 sequences a cell, as “Avg. ADE” / FDE: A, SGAN 12.4 /
2.28 and 16.32 / 3.24, NeuroSyM 7.06 / 1.31 and 2.52 / 0.68; B, SGAN 10.88 / 2.67 and 24.27 / 5.0,
NeuroSyM 5.7 / 1.4 and 9.87 / 1.8. Its “Avg. ADE” is a sum over steps and people. Its runtimes of 4
to 7 s count from the collection of the observation, so they are not latencies."""

FIGURES = """When each id of recording 1 was seen, before and after stitching: a row for each id, a
colour for each person. Then the forecast with the median error of NeuroSyM, and the mean error of
the published forecast at each step."""

TAIL = """<details markdown="1">
<summary>Models and recordings</summary>

{models}. Each recording lasts {seconds:.0f} s. Latencies: each model alone, {latencies} (median);
jax {jax}, {threads} threads of a CPU. Mghames, Castri, Hanheide and Bellotto, “neuROSym: Deployment
and Evaluation of a ROS-based Neuro-Symbolic Model for Human Motion Prediction”, 2024.

</details>"""


def write_report(
    out: Path,
    recordings: Sequence[Recording],
    latencies: Mapping[Scenario, Mapping[str, float]],
    seconds: float,
) -> Path:
    """Write `experiment.md` and `.json`, and the figures, to `out`; the page's path.

    `latencies` are medians in milliseconds from a frame's arrival to its forecast, `seconds` the
    length of a recording.
    """
    raw, mended = np.mean([each.identity for each in recordings], axis=0)
    medians = {
        f"{NAMES[scenario][0]}, {name}": latency
        for scenario, models in latencies.items()
        for name, latency in models.items()
    }
    noise, latency, where = 100 * FAULTS.noise, max(medians.values()), run_environment()
    blocks = [
        HEAD.format(raw=raw, mended=mended, latency=latency, noise=noise),
        _errors(recordings),
        NOTE,
        "## Stitching",
        _chain(recordings),
    ]
    for scenario, title in NAMES.items():
        blocks += [f"## Scenario {title}", FIGURES]
        blocks += write_figures(out, [each for each in recordings if each.scenario == scenario])
    texts = ", ".join(f"{name} {value:.1f} ms" for name, value in medians.items())
    names = " and ".join(f"`{name}`" for name in MODELS)
    blocks.append(TAIL.format(models=names, seconds=seconds, latencies=texts, **where))
    data = [
        {
            "bag": each.bag.name,
            "idf1": each.identity,
            "scores": {name: dataclasses.asdict(score) for name, score in each.scores.items()},
            "analytics": each.summary,
        }
        for each in recordings
    ]
    write_json(out / "experiment.json", {"environment": where, "recordings": data})
    write_text(out / "experiment.md", "\n\n".join(blocks) + "\n")
    return out / "experiment.md"


def _errors(recordings: Sequence[Recording]) -> str:
    rows = [
        [
            f"{NAMES[recording.scenario][0]} {recording.number}",
            name,
            f"{score.ade:.2f} / {score.fde:.2f}",
            f"{score.best_ade:.2f} / {score.best_fde:.2f}" if name != STRAIGHT else "–",
            f"{score.sum_ade:.1f} / {score.sum_fde:.1f}",
        ]
        for recording in recordings
        for name, score in recording.scores.items()
    ]
    head = ["recording", "model", "ADE / FDE", "best of k", "summed"]
    return markdown_table(head, rows, right=3)


def _chain(recordings: Sequence[Recording]) -> str:
    rows = []
    for each in recordings:
        raw, mended = each.identity
        scored = [
            next(iter(s["models"].values()))["people"] for s in (each.unstitched, each.summary)
        ]
        before = {*np.concatenate([frame.ids for frame in each.frames])}
        after = {*np.concatenate(each.mended)} - {-1}
        rows.append(
            [
                f"{NAMES[each.scenario][0]} {each.number}",
                f"{len(before)} → {len(after)}",
                f"{raw:.2f} → {mended:.2f}",
                f"{scored[0]} → {scored[1]}",
            ]
        )
    return markdown_table(["recording", "ids", "IDF1", "people scored"], rows, right=3)
