"""Tables: runs of one model are one line, means over test sets, and what a paper takes."""

import csv
import dataclasses
import io
import re
from unittest import mock

import numpy as np
import pytest
from scipy.stats import t

from neurosym_jax.evaluation.metrics import METRICS
from neurosym_jax.evaluation.results import rows_frame
from neurosym_jax.evaluation.summary import conclusion, lines_of, means_of
from neurosym_jax.evaluation.tables import format_table


def columns(name, mean, half):
    return {
        name: mean,
        f"{name}_low": mean - half,
        f"{name}_high": mean + half,
        f"{name}_std": None,
    }


def row(model, scene, ade, checkpoint=None, half=0.01):
    return {
        "checkpoint": checkpoint,
        "model": model,
        "dataset": scene,
        "obs_len": 8,
        "pred_len": 8,
        "samples": 20,
        "seeds": 1,
        "scenes": 602,
        "agents": 2253,
        "blocks": 50,
        **columns("joint_ade", ade, half),
        **columns("collision_rate", 0.05, 0.01),
        **dict.fromkeys(("own", "own_low", "own_high", "own_std")),
        "latency": 0.001,
        "forecasts_per_second": 1000.0,
    }


SCENES = ("eth", "zara1")
TRAININGS = [
    row("SGAN", scene, 0.2 + 0.1 * at + 0.01 * seed, f"runs/sgan_{scene}_8_8_seed{seed}/model")
    for at, scene in enumerate(SCENES)
    for seed in range(3)
]
ROWS = [row("constant velocity", scene, 0.5) for scene in SCENES] + TRAININGS


def test_trainings_that_differ_in_their_seed_are_one_line():
    lines = lines_of(ROWS)
    assert [(line.model, line.trainings) for line in lines[2:]] == [("SGAN", 3), ("SGAN", 3)]
    value = lines[2].values["joint_ade"]
    assert value.mean == pytest.approx(0.21)
    assert value.spread == pytest.approx(0.01)
    assert value.interval.high - 0.21 == pytest.approx(t.ppf(0.975, 2) * 0.01 / 3**0.5)
    assert value.best
    assert not lines[0].values["joint_ade"].best
    # Without a seed in their names they are models of their own, even of the same file.
    alike = [row("SGAN", "eth", 0.2, "a.pt"), row("SGAN", "eth", 0.2, "a.pt")]
    assert len(lines_of(alike)) == 2


def test_means_are_of_models_that_were_tested_everywhere():
    means = means_of(lines_of([*ROWS, row("NeuroSyM", "eth", 0.1, "neurosym_eth")]))
    assert [line.model for line in means] == ["constant velocity", "SGAN"]
    constant, sgan = (line.values["joint_ade"] for line in means)
    assert constant.mean == pytest.approx(0.5)
    # Test sets are independent of each other.
    assert constant.interval.high - 0.5 == pytest.approx(0.01 / 2**0.5)
    # Runs of one seed are not, so seeds are averaged over test sets first.
    assert sgan.mean == pytest.approx(0.26)
    assert sgan.spread == pytest.approx(0.01)
    assert means_of(lines_of(ROWS[:1])) == []


def test_bold_only_where_the_interval_says_so():
    def best(low, high):
        lines = lines_of([row("a", "eth", low), row("b", "eth", high)])
        return [line.values["joint_ade"].best for line in lines]

    assert best(0.20, 0.23) == [True, False]
    with mock.patch.dict(METRICS):
        METRICS["joint_ade"] = dataclasses.replace(METRICS["joint_ade"], higher_is_better=True)
        assert best(0.20, 0.23) == [False, True]
    assert best(0.20, 0.21) == [False, False]
    assert [line.values["joint_ade"].best for line in lines_of([row("a", "eth", 0.2)])] == [False]


def test_csv_has_the_numbers_as_they_are():
    table = list(csv.DictReader(io.StringIO(format_table(rows_frame(ROWS), "csv"))))
    assert [of["dataset"] for of in table[:4]] == ["eth", "zara1", "eth", "zara1"]
    assert float(table[0]["joint_ade"]) == 0.5
    assert float(table[0]["joint_ade_low"]) == 0.49
    assert table[2]["trainings"] == "3"
    assert table[-1]["dataset"] == "mean of eth, zara1"
    assert np.isclose(float(table[-1]["joint_ade"]), 0.26)


def test_latex_is_well_formed():
    rows = [row("A&B_50%", "zara_1", 0.5), row("SGAN", "zara_1", 0.2), row("SGAN", "eth", 0.2)]
    text = format_table(rows_frame(rows), "latex")
    assert text.startswith("% \\usepackage{booktabs}\n")
    body = "\n".join(line for line in text.splitlines() if not line.startswith("%"))
    columns = re.search(r"\\begin\{tabular\}\{([lr]+)\}", body)[1]
    lines = [line for line in body.splitlines() if line.endswith(r"\\")]
    assert len(lines) == 1 + len(rows) + 1  # the mean of what was tested on both
    for line in lines:
        assert len(re.findall(r"(?<!\\)&", line)) == len(columns) - 1
        assert not re.findall(r"(?<!\\)[%_#]", line)
    assert body.count("{") == body.count("}")
    for rule in ("toprule", "bottomrule"):
        assert body.count(f"\\{rule}") == 1
    assert body.endswith("\\end{tabular}")
    assert r"A\&B\_50\%" in body
    assert r"\textbf{0.200} {\footnotesize [0.190, 0.210]}" in body


def test_markdown_marks_the_best():
    text = format_table(rows_frame(ROWS), "markdown")
    assert "| eth | SGAN (3 trainings) | 20 | **0.210** [0.185, 0.235] |" in text
    assert text.count("**") == 6


@pytest.mark.parametrize(
    ("paths", "shown"),
    [
        (["a/x/1.pt", "a/y/1.pt"], ["x", "y"]),
        (["a/1.pt", "b/1.pt", "b/2.pt"], ["a/1.pt", "b/1.pt", "b/2.pt"]),
        (["m/1.pt", "a/2.pt"], ["1.pt", "2.pt"]),
        (["m/1.pt"], [""]),
    ],
)
def test_checkpoints_where_they_tell_models_apart(paths, shown):
    text = format_table(rows_frame([row("SGAN", "eth", 0.2, path) for path in paths]), "markdown")
    found = [line.split("|")[2].strip() for line in text.splitlines()[2:]]
    assert found == [f"SGAN {name}".strip() for name in shown]


def test_a_table_fits_the_terminal():
    rows = rows_frame([row("constant velocity", "eth", 0.431), row("SGAN", "eth", 0.3, "a.pt")])
    for width in (60, 80):
        lines = [line.rstrip() for line in format_table(rows, width=width).splitlines()]
        note = next(at for at, line in enumerate(lines) if line.startswith("joint: "))
        assert max(map(len, lines[:note])) <= width
        at = lines.index("eth: 8 + 8 steps, 602 scenes, 2253 people")
        assert lines[at + 2].split()[:2] == ["model", "ADE"]
        assert lines[at + 3].startswith("constant velocity  0.431 ±.010  ")
        assert lines[at + 4].startswith("SGAN               0.300 ±.010*")
        assert "own" not in "".join(lines)  # It has no value anywhere.
    assert "by bootstrap over 50 blocks of scenes" in lines[-2]
    assert lines[-1].startswith("*: significantly better than all others")


def test_the_conclusion_names_what_is_significant():
    near = [row("a", "eth", 0.20), row("b", "eth", 0.21)]
    assert conclusion(lines_of(near), 0.4) == (
        "Mean error over the next 3.2 s, best of 20 forecasts: 0.20 m for a and 0.21 m for b. No "
        "model is significantly better than all others (95 % intervals overlap)."
    )
    apart = [row("a", "zara1", 0.2), {**row("b", "zara1", 0.3), "samples": 1}]
    text = conclusion(lines_of([*near, *apart]), 0.4, simulated=True)
    assert "0.25 m for b (one forecast)" not in text
    assert text.endswith(
        "a is significantly better on zara1 (95 % intervals do not overlap); on eth no model is "
        "significantly better. Simulated people say nothing about real ones."
    )
