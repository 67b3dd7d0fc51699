"""The report of the experiment: tables, figures, and what the robot paper printed."""

import dataclasses
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np

from neurosym_jax.evaluation.markdown import markdown_table
from neurosym_jax.runtime.environment import run_environment
from neurosym_jax.runtime.files import write_json, write_text
from neurosym_jax.simulation.scenarios import Scenario
from neurosym_robot.online.analytics import STRAIGHT
from studies.experiment.figures import write_figures
from studies.experiment.results import Recording, Results

__all__ = ["write_report"]

NAMES: dict[Scenario, str] = {"all-forward": "A, all-forward", "cross-path": "B, cross-path"}
PAPER = (
    ("A, all-forward", "SGAN", "12.4, 16.32", "2.28, 3.24"),
    ("A, all-forward", "NeuroSyM", "7.06, 2.52", "1.31, 0.68"),
    ("B, cross-path", "SGAN", "10.88, 24.27", "2.67, 5.0"),
    ("B, cross-path", "NeuroSyM", "5.7, 9.87", "1.4, 1.8"),
)
"""Scenario, model, "Avg. ADE" and FDE as printed, two values a cell, of 3 to 7 sequences each."""
PAPER_RUNTIME = (("A, all-forward", "4.17, 5.37"), ("B, cross-path", "5.19, 7.36"))
"""Seconds, two values a scenario."""


def write_report(out: Path, results: Results) -> Path:
    """Write `experiment.md` and `.json`, and the figures, to `out`; the page's path."""
    blocks = [*_introduction(results)]
    for number, scenario in zip(("I", "II"), NAMES):
        here = [each for each in results.recordings if each.scenario == scenario]
        blocks += [f"## Scenario {NAMES[scenario]}"]
        blocks += [*_errors(f"Table {number}. Errors in scenario {NAMES[scenario]}", here)]
        blocks += write_figures(out, here)
    blocks += [*_runtime(results), *_chain(results.recordings), *_paper()]
    _write_json(out / "experiment.json", results)
    page = out / "experiment.md"
    write_text(page, "\n\n".join(blocks) + "\n")
    return page


def _introduction(results: Results) -> Iterator[str]:
    faults, chosen = results.faults, results.models
    yield "# The robot experiment, repeated on simulated recordings"
    yield _text(
        """See what a robot's whole chain does, from a tracker's messages to errors of forecasts,
        and run it yourself."""
    )
    yield _text(
        f"""Two people in a room of 5 m x 8.2 m, two scenarios, two recordings of
        {results.seconds:.0f} s each: they walk abreast to the room's end and back (A), or cross
        each other's way (B). A social-force simulation walks them. A tracker at 10 Hz sees them:
        noise of {100 * faults.noise:.0f} cm, and each person is lost every 20 s on average, for
        {faults.dropout_seconds:.0f} s on average, to come back under a new id. Bags keep what it
        says; they are read back and go frame by frame through stitching, prediction and analytics,
        as live messages would. **These are not the paper's recordings**: the numbers show that the
        chain works and what it costs, not how a method ranks on real people."""
    )
    yield "    python -m studies.experiment --out results/experiment"
    yield "**Models of 8 observed and 8 forecast steps of 0.4 s**"
    rows = [
        [NAMES[scenario], ", ".join(f"`{path.name}`" for path in paths)]
        for scenario, paths in chosen.items()
    ]
    yield markdown_table(["Scenario", "Models"], rows)
    yield _text(
        """The paper's models for A were trained on Zara01. Models that ship here for `zara1` were
        trained on the other scenes of ETH/UCY and have not seen Zara01."""
    )
    yield "The paper's models for B were trained on THÖR. " + _of_thor(chosen)


def _text(text: str) -> str:
    return " ".join(text.split())


def _of_thor(chosen: Mapping[Scenario, Sequence[Path]]) -> str:
    names = [path.name for path in chosen["cross-path"]]
    if names == [path.name for path in chosen["all-forward"]]:
        return "**No such models ship here, so B uses those of A.**"
    if all("thor" in name for name in names):
        return "So were these, leaving out the recording in their name."
    return "These are others."


def _errors(caption: str, recordings: Sequence[Recording]) -> Iterator[str]:
    rows = [
        [
            str(recording.number),
            name,
            str(score.sequences),
            f"{score.ade:.2f} / {score.fde:.2f}",
            f"{score.best_ade:.2f} / {score.best_fde:.2f}" if name != STRAIGHT else "–",
            f"{score.sum_ade:.2f} / {score.sum_fde:.2f}",
        ]
        for recording in recordings
        for name, score in recording.scores.items()
    ]
    yield f"**{caption}**"
    head = ["Recording", "Model", "Sequences", "ADE / FDE", "best of k", "summed"]
    yield markdown_table(head, rows, right=4)
    yield _text(
        """Metres. A sequence is a forecast in which both people have a full window and a known
        future; consecutive ones overlap, one starts every 0.4 s. ADE / FDE: means over people (and
        steps) of the forecast that is published, the most central sample. Best of k: of all
        samples, the best for both people together. Summed: the published forecast's errors summed
        over people (and, for ADE, the 8 steps), as the paper's tables have them."""
    )


def _runtime(results: Results) -> Iterator[str]:
    yield "## Runtime"
    yield "**Table III. Compute latency in milliseconds, from a frame's arrival to its forecast**"
    rows = [
        [NAMES[scenario], name, *(f"{latency[key]:.2f}" for key in ("p50", "p90", "p99"))]
        for scenario, models in results.latencies.items()
        for name, latency in models.items()
    ]
    yield markdown_table(["Scenario", "Model", "p50", "p90", "p99"], rows, right=3)
    where = run_environment()
    yield _text(
        f"""Each model alone, recording 1, stitching not counted; jax {where["jax"]} on
        {where["threads"]} threads of a CPU. The paper's runtimes count from the collection of the
        observation, 8 steps, so they are quoted below and not compared."""
    )


def _chain(recordings: Sequence[Recording]) -> Iterator[str]:
    rows, dropped = [], Counter[str]()
    for each in recordings:
        raw, mended = each.identity
        scored = [
            next(iter(s["models"].values()))["people"] for s in (each.unstitched, each.summary)
        ]
        ids = np.concatenate([frame.ids for frame in each.frames])
        dropped.update(each.summary["dropped"])
        rows.append(
            [
                f"{NAMES[each.scenario][0]} {each.number}",
                f"`{each.bag.name}`",
                str(len(each.frames)),
                f"{len(np.unique(ids))} → {len(np.unique(np.concatenate(each.mended)))}",
                f"{raw:.2f} → {mended:.2f}",
                f"{scored[0]} → {scored[1]}",
            ]
        )
    yield "## The chain"
    yield "**What was recorded, and what stitching is worth**"
    yield markdown_table(["", "Bag", "Frames", "Ids", "IDF1", "People scored"], rows, right=4)
    reasons = ", ".join(f"{reason} {count}" for reason, count in dropped.items())
    yield _text(
        f"""Arrows: before and after stitching. People scored are those with a forecast and a future
        that was seen. Without forecast or score, with stitching, in all recordings: {reasons}."""
    )


def _paper() -> Iterator[str]:
    yield "## What the paper printed"
    yield "**The paper's errors, as printed**"
    yield markdown_table(["Scenario", "Model", "“Avg. ADE”", "FDE"], PAPER, right=2)
    yield "**The paper's runtimes, in seconds**"
    yield markdown_table(["Scenario", "Runtime"], PAPER_RUNTIME, right=1)
    yield _text(
        """Mghames, Castri, Hanheide and Bellotto, “neuROSym: Deployment and Evaluation of a
        ROS-based Neuro-Symbolic Model for Human Motion Prediction”, 2024. “Avg. ADE” there is the
        sum over the 8 forecast steps and over people, as the released plotting code computes it, so
        it stands beside our column “summed”. Each cell rests on 3 to 7 sequences of real people,
        and the released post-processing names recordings of its own for each model, whereas here
        both see the same frames."""
    )


def _write_json(path: Path, results: Results) -> None:
    data = {
        "environment": run_environment(),
        "seeds": results.seeds,
        "samples": results.samples,
        "latency_ms": results.latencies,
        "recordings": [
            {
                "scenario": each.scenario,
                "number": each.number,
                "bag": each.bag.name,
                "idf1": each.identity,
                "scores": {name: dataclasses.asdict(s) for name, s in each.scores.items()},
                "analytics": each.summary,
            }
            for each in results.recordings
        ],
    }
    write_json(path, data)
