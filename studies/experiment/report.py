"""The report of the experiment: tables, figures, and what the robot paper printed."""

import dataclasses
import os
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from neurosym_jax.evaluation.tables import markdown_table
from neurosym_jax.runtime.files import write_json, write_text
from neurosym_jax.runtime.process import run_environment
from neurosym_jax.simulation.scenarios import Scenario
from neurosym_robot.online.replay import STRAIGHT
from studies.experiment.figures import write_figures
from studies.experiment.results import FAULTS, MODELS, Recording

__all__ = ["write_report"]

NAMES: dict[Scenario, str] = {
    "all-forward": "A, all-forward",
    "cross-path": "B, cross-path",
}
PAPER: dict[Scenario, dict[str, tuple[tuple[float, float], ...]]] = {
    "all-forward": {
        "SGAN": ((12.4, 2.28), (16.32, 3.24)),
        "NeuroSyM": ((7.06, 1.31), (2.52, 0.68)),
    },
    "cross-path": {
        "SGAN": ((10.88, 2.67), (24.27, 5.0)),
        "NeuroSyM": ((5.7, 1.4), (9.87, 1.8)),
    },
}
"""What the robot paper printed of real people: "Avg. ADE" and FDE of each recording."""
RUNTIMES = "A 4.17 and 5.37 s, B 5.19 and 7.36 s"

HEAD = """# The robot experiment, on simulated people

**The whole chain works, from a tracker's messages to scored forecasts: stitching raises IDF1 from
{raw:.2f} to {mended:.2f}, and a forecast takes {latency:.0f} ms.
{ahead}**

The robot paper's experiment (two people, two scenarios, two recordings each) is repeated with
simulated people and other networks, so the numbers show that the chain works and what it costs, not
which network is better on real people.

    python -m studies.experiment --out results/experiment

In scenario A two people walk side by side to the end of a room and back; in B they cross. A tracker
at 10 Hz sees them with {noise:.0f} cm of noise, and loses each of them every 20 s on average. Its
messages go into bags and come back frame by frame through stitching, prediction and analytics.

**Networks.** Both scenarios are forecast by {models}; one training
each, for ADE and FDE and without an adversarial term. Those that ship learned from ETH/UCY without
zara1. The paper's scenario B used networks trained on THÖR; `--models` takes others. Real tracks
have not been replayed here."""

NOTE = """Metres. Avg. ADE: the paper's sum over people and steps, of the published forecast, which
is the central forecast; FDE: summed over people. Mean: the same per person (and step). Best of k:
the best sample for both people together. Consecutive forecasts overlap. Runtime: median from a
frame's arrival to its forecast, the model alone. The paper's cells rest on 3 to 7 sequences of real
people; its runtimes ({paper}) count from the collection of the observation, so they are not
latencies."""

FIGURES = """For each scenario: when each id of recording 1 was seen, before and after stitching (a
row for each id, a colour for each person); the forecast with the median error of NeuroSyM; and the
mean error of the published forecast at each step."""

TAIL = """<details markdown="1">
<summary>Recordings and source</summary>

Each recording lasts {seconds:.0f} s; jax {jax}, {threads} threads of a CPU, load average {load:.0f}
(above {threads}, runtimes suffer). Mghames, Castri, Hanheide and Bellotto, “neuROSym: Deployment
and Evaluation of a ROS-based Neuro-Symbolic Model for Human Motion Prediction”, 2024.

</details>"""


def write_report(
    out: Path,
    recordings: Sequence[Recording],
    latencies: Mapping[Scenario, Mapping[str, float]],
    seconds: float,
    models: Sequence[str] = MODELS,
) -> Path:
    """Write `experiment.md` and `.json`, and the figures, to `out`; the page's path.

    `latencies` are medians in milliseconds from a frame's arrival to its forecast,
    `seconds` the length of a recording, `models` the names or folders of the networks.
    """
    raw, mended = np.mean([recording.identity for recording in recordings], axis=0)
    noise, environment = 100 * FAULTS.noise, run_environment()
    latency = max(max(medians.values()) for medians in latencies.values())
    head = HEAD.format(
        raw=raw,
        mended=mended,
        latency=latency,
        ahead=_ahead(recordings),
        noise=noise,
        models=" and ".join(f"`{name}`" for name in models),
    )
    blocks = [head]
    for scenario, title in NAMES.items():
        members = [
            recording for recording in recordings if recording.scenario == scenario
        ]
        blocks += [f"## Scenario {title}", _errors(members, latencies[scenario])]
        blocks += [NOTE.format(paper=RUNTIMES)] if len(blocks) == 3 else []
    blocks += ["## Stitching", _chain(recordings), "## Figures", FIGURES]
    for scenario in NAMES:
        members = [
            recording for recording in recordings if recording.scenario == scenario
        ]
        blocks += write_figures(out, members)
    blocks.append(TAIL.format(seconds=seconds, load=os.getloadavg()[1], **environment))
    data = []
    for recording in recordings:
        scores = recording.scores.items()
        row = {
            "bag": recording.bag.name,
            "idf1": recording.identity,
            "scores": {name: dataclasses.asdict(score) for name, score in scores},
            "analytics": recording.summary,
        }
        data.append(row)
    write_json(
        out / "experiment.json", {"environment": environment, "recordings": data}
    )
    write_text(out / "experiment.md", "\n\n".join(blocks) + "\n")
    return out / "experiment.md"


def _ahead(recordings: Sequence[Recording]) -> str:
    """The sentence on who is ahead of whom, by the ADE of the published forecast."""
    behind = [
        100 * (recording.scores["NeuroSyM"].ade / recording.scores["SGAN"].ade - 1)
        for recording in recordings
    ]
    number = sum(percent > 0 for percent in behind)
    claim = (
        "the reverse of the paper's claim"
        if number > len(behind) / 2
        else "as in the paper"
    )
    return (
        f"NeuroSyM is behind SGAN in {number} of {len(behind)} recordings (ADE "
        f"{min(behind):+.0f} to {max(behind):+.0f} %), {claim}."
    )


def _errors(recordings: Sequence[Recording], latencies: Mapping[str, float]) -> str:
    """The paper's table of a scenario: a row for each recording and model, its numbers beside."""
    rows = []
    for recording in recordings:
        for name, score in recording.scores.items():
            cells = PAPER[recording.scenario].get(name)
            paper = (
                [f"{value:.2f}" for value in cells[recording.number - 1]]
                if cells
                else ["", ""]
            )
            latency, best = "", ""
            if name != STRAIGHT:
                latency = f"{latencies[name]:.1f} ms"
                best = f"{score.best_ade:.2f} / {score.best_fde:.2f}"
            rows.append(
                [
                    f"{NAMES[recording.scenario][0]} {recording.number}",
                    name,
                    f"{score.sum_ade:.1f}",
                    f"{score.sum_fde:.1f}",
                    *paper,
                    latency,
                    f"{score.ade:.2f} / {score.fde:.2f}",
                    best,
                ]
            )
    head = [
        "recording",
        "model",
        "Avg. ADE",
        "FDE",
        "paper's Avg. ADE",
        "paper's FDE",
        "runtime",
    ]
    return markdown_table([*head, "mean ADE / FDE", "best of k"], rows, right=7)


def _chain(recordings: Sequence[Recording]) -> str:
    rows = []
    for recording in recordings:
        raw, mended = recording.identity
        scored = [
            next(iter(summary["models"].values()))["people"]
            for summary in (recording.unstitched, recording.summary)
        ]
        before = {*np.concatenate([frame.ids for frame in recording.frames])}
        after = {*np.concatenate(recording.mended)} - {-1}
        rows.append(
            [
                f"{NAMES[recording.scenario][0]} {recording.number}",
                f"{len(before)} → {len(after)}",
                f"{raw:.2f} → {mended:.2f}",
                f"{scored[0]} → {scored[1]}",
            ]
        )
    return markdown_table(["recording", "ids", "IDF1", "people scored"], rows, right=3)
