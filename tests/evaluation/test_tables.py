"""Tables: runs of one model are one line, means over test sets, and what a paper takes."""

import contextlib
import csv
import dataclasses
import io
import itertools
import re

import numpy as np
import polars as pl
import pytest
from matplotlib.font_manager import FontProperties
from matplotlib.textpath import TextPath
from scipy.stats import t

from neurosym_jax.evaluation.metrics import METRICS
from neurosym_jax.evaluation.tables import (
    format_table,
    markdown_table,
    rows_frame,
    summarise,
)
from tests.repository import ROOT
from tests.rows import result_row


def row(model, scene, ade, checkpoint=None, **fields):
    means = {"joint_ade": ade, "collision_rate": 0.05, "own": None}
    return result_row(model, scene, means, checkpoint, **fields)


SCENES = ("eth", "zara1")
TRAININGS = [
    row(
        "SGAN",
        scene,
        0.2 + 0.1 * at + 0.01 * seed,
        f"runs/{'abc'[seed]}_{scene}/model",
        configuration="sgan",
        training_data=f"all but {scene}",
        training_seed=seed,
    )
    for (at, scene), seed in itertools.product(enumerate(SCENES), range(3))
]
ROWS = [row("constant velocity", scene, 0.5, p=0.001) for scene in SCENES] + TRAININGS


def lines_of(rows, metric="joint_ade"):
    """The values of a metric, those of test sets and those of means."""
    values = summarise(rows_frame(rows)).filter(metric=metric)
    return values.filter(sets=1).to_dicts(), values.filter(
        pl.col("sets") > 1
    ).to_dicts()


def test_trainings_that_differ_in_their_seed_are_one_line():
    lines, _ = lines_of(ROWS)
    assert [(line["model"], line["trainings"]) for line in lines[2:]] == [
        ("SGAN", 3)
    ] * 2
    value = lines[2]
    assert value["checkpoint"] == "runs/*/model"
    assert value["mean"] == pytest.approx(0.21)
    assert value["std"] == pytest.approx(0.01)
    assert value["high"] - 0.21 == pytest.approx(t.ppf(0.975, 2) * 0.01 / 3**0.5)
    assert value["best"]
    assert not lines[0]["best"]
    # Without a known seed they are models of their own, even of the same file.
    same_rows = [row("SGAN", "eth", 0.2, "a.pt"), row("SGAN", "eth", 0.2, "a.pt")]
    assert len(lines_of(same_rows)[0]) == 2
    assert lines_of(ROWS, "own")[0][2]["mean"] is None


@pytest.mark.parametrize(
    "other",
    [{"configuration": "wider"}, {"training_data": "all"}, {"training_seed": 0}],
)
def test_models_that_differ_in_more_than_their_seed_are_lines_of_their_own(other):
    """Folders named by seeds say nothing: what was trained, and on what, does."""
    known = {"configuration": "sgan", "training_data": "most", "training_seed": 0}
    first = row("SGAN", "eth", 0.2, "exp/seed0/model", **known)
    second = row(
        "SGAN", "eth", 0.4, "exp/seed1/model", **{**known, "training_seed": 1, **other}
    )
    lines = lines_of([first, second])[0]
    assert [(line["trainings"], line["mean"]) for line in lines] == [(1, 0.2), (1, 0.4)]


def test_means_are_of_models_that_were_tested_everywhere():
    _, means = lines_of([*ROWS, row("NeuroSyM", "eth", 0.1, "neurosym_eth")])
    assert [line["model"] for line in means] == ["constant velocity", "SGAN"]
    constant, sgan = means
    assert constant["mean"] == pytest.approx(0.5)
    # Test sets are independent of each other.
    assert constant["high"] - 0.5 == pytest.approx(0.01 / 2**0.5)
    # Runs of one seed are not, so seeds are averaged over test sets first.
    assert sgan["mean"] == pytest.approx(0.26)
    assert sgan["std"] == pytest.approx(0.01)
    assert lines_of(ROWS[:1])[1] == []


def test_bold_only_where_the_paired_tests_say_so():
    def best(*p_values):
        rows = [row(f"model {at}", "eth", 0.2, p=p) for at, p in enumerate(p_values)]
        return [line["best"] for line in lines_of(rows)[0]]

    assert best(None, 0.049) == [True, False]
    assert best(0.01, None, 0.04) == [False, True, False]
    assert best(None, 0.051) == [False, False]
    assert best(None, 0.01, 0.9) == [False, False, False]
    assert best(None) == [False]
    # Rows of two evaluations were not compared, nor those of an older report.
    assert best(None, 0.01, None) == [False, False, False]
    rows = [row("a", "eth", 0.2), row("b", "eth", 0.9)]
    for report_row in rows:
        del report_row["joint_ade_p"]
    assert [line["best"] for line in lines_of(rows)[0]] == [False, False]


def test_means_over_test_sets_are_compared_set_by_set():
    """A model that is 2 to 4 cm better on each of five sets, which differ by more."""
    lead = [0.02, 0.03, 0.04, 0.03, 0.03]
    errors = {"ours": np.arange(1, 6) / 10 - lead, "theirs": np.arange(1, 6) / 10}
    rows = []
    for model, values in errors.items():
        rows += [row(model, f"set {n}", error) for n, error in enumerate(values)]
    _, (leader, follower) = lines_of(rows)
    assert (leader["p"], leader["best"], follower["best"]) == (None, True, False)
    assert follower["p"] == pytest.approx(
        2 * t.sf(0.03 / (0.005**0.5 / 10 / 5**0.5), 4)
    )
    joint_ade = METRICS["joint_ade"]
    METRICS["joint_ade"] = dataclasses.replace(joint_ade, higher_is_better=True)
    assert [line["best"] for line in lines_of(rows)[1]] == [False, True]
    METRICS["joint_ade"] = dataclasses.replace(joint_ade, higher_is_better=None)
    assert [line["best"] for line in lines_of(rows)[1]] == [False, False]


HOSTILE = "\\input{x}\n\x1b[31m$&%#_|`<b>*"


@pytest.mark.parametrize("style", ["text", "csv", "markdown", "latex"])
def test_hostile_names_stay_text(style):
    rows = [
        row(HOSTILE, f"{HOSTILE}{number}", 0.3, f"{HOSTILE}/{number}")
        for number in range(2)
    ]
    text = format_table(rows_frame(rows), style, width=500)
    assert "\x1b" not in text
    plain = format_table(rows_frame([row("a", "b", 0.3, "c")] * 2), style, width=500)
    if style == "text":
        assert len(text.splitlines()) < 2 * len(plain.splitlines()) + 6
    if style == "csv":
        assert {line["model"] for line in csv.DictReader(io.StringIO(text))} == {
            "\\input{x}\\n\\x1b[31m$&%#_|`<b>*"
        }
    if style == "markdown":
        assert all(
            line.startswith("|") and line.endswith("|") for line in text.splitlines()
        )
        assert "<b>" not in text
    if style == "latex":
        assert "\\input" not in re.sub(r"(?m)^%.*$", "", text)
        assert all(
            line.startswith(("%", "\\", " &", r"\textbackslash{}"))
            for line in text.splitlines()
        )


@pytest.mark.parametrize("name", ["=1+1", "+cmd", "@x", "-cmd|'/C calc'!A0"])
def test_a_spreadsheet_calculates_no_name(name):
    text = format_table(rows_frame([row(name, name, -0.3, name)]), "csv")
    (line,) = csv.DictReader(io.StringIO(text))
    for column in ("dataset", "model", "checkpoint"):
        assert line[column] == f"'{name}"
    assert line["joint_ade"] == "-0.3"


@pytest.mark.parametrize("name", ["-", "-1.5 m", "a=b", "NeuroSyM, cnd", "1+1"])
def test_names_that_are_no_formula_stay_in_a_csv(name):
    text = format_table(rows_frame([row(name, "eth", 0.3)]), "csv")
    (line,) = csv.DictReader(io.StringIO(text))
    assert line["model"] == name


def test_too_few_blocks_are_said():
    rows = [
        row("SGAN", "eth", 0.3, half=None, blocks=2),
        row("CV", "eth", 0.9, half=None, blocks=2),
    ]
    text = format_table(rows_frame(rows))
    assert "fewer than 3 blocks say nothing: no interval, no test" in text
    assert "0.300 ±" not in text
    assert "| 0.300 [too few blocks] |" in format_table(rows_frame(rows), "markdown")


def test_csv_has_the_numbers_as_they_are():
    table = list(csv.DictReader(io.StringIO(format_table(rows_frame(ROWS), "csv"))))
    assert [line["dataset"] for line in table[:4]] == ["eth", "zara1", "eth", "zara1"]
    assert float(table[0]["joint_ade"]) == 0.5
    assert float(table[0]["joint_ade_low"]) == 0.49
    assert table[2]["trainings"] == "3"
    assert table[-1]["dataset"] == "mean of eth, zara1"
    assert np.isclose(float(table[-1]["joint_ade"]), 0.26)


def test_latex_is_well_formed_and_names_are_short():
    names = ("A&B_50%", "constant velocity, sampled", "NeuroSyM, soft,factor=0.1")
    rows = [
        row(name, "zara_1", 0.5 - 0.1 * at, p=(0, 0, None)[at])
        for at, name in enumerate(names)
    ]
    rows.append(row(names[2], "eth", 0.2))
    text = format_table(rows_frame(rows), "latex")
    assert text.startswith("% \\usepackage{booktabs}\n")
    assert "% CV, sampled: constant velocity, sampled\n" in text
    body = "\n".join(line for line in text.splitlines() if not line.startswith("%"))
    columns = re.search(r"\\begin\{tabular\}\{@\{\}(l[lr]+)@\{\}\}", body)[1]
    lines = [line for line in body.splitlines() if line.endswith(r"\\")]
    cells = [re.split(r"(?<!\\)&", line.removesuffix(r" \\")) for line in lines]
    # Two rows of head, a title for each test set and the mean of what was tested on
    # both.
    assert len(cells) == 2 + 3 + len(rows) + 1
    for row_ in cells:
        spans = [re.match(r"\s*\\multicolumn\{(\d+)\}", cell) for cell in row_]
        assert sum(int(span[1]) if span else 1 for span in spans) == len(columns)
        assert not re.findall(r"(?<!\\)[%_#]", "".join(row_))
    assert body.count("{") == body.count("}")
    assert r"A\&B\_50\% & 20 & 0.500 & 5.0 \%" in body
    assert "\nCV, sampled & 20 & 0.400 &" in body
    assert "\nNeuroSyM, soft & 20 & \\textbf{0.300} &" in body
    assert "[" not in body
    with_intervals = format_table(rows_frame(rows), "latex", intervals=True)
    assert r"\textbf{0.300}{\scriptsize [0.290, 0.310]}" in with_intervals
    assert "95 % interval by Student's t" in with_intervals
    # Names that would be the same without their options keep them.
    same = [
        row(f"NeuroSyM, quantised,factor={factor}", "zara1", 0.4) for factor in (1, 2)
    ]
    assert "factor=1" in format_table(rows_frame(same), "latex")


def test_latex_fits_one_column_of_a_paper():
    """Widths are of Computer Modern's letters: `\\footnotesize` are 8 points, a column 241."""
    font = FontProperties("cmr10")

    def points(text):
        plain = re.sub(
            r"\\multicolumn\{\d+\}\{\w\}|\\(textbf|emph)|[\\{}$]", "", text
        ).strip()
        return TextPath((0, 0), plain, 8, prop=font).get_extents().width if plain else 0

    names = (
        "constant velocity",
        "constant velocity, sampled",
        "NeuroSyM, quantised,factor=0.1",
    )
    rows = [row(name, "zara1", 1.2) for name in names]
    for report_row in rows:
        for name in ("joint_fde", "marginal_ade", "marginal_fde"):
            ends = ("", "_low", "_high", "_std", "_p")
            report_row |= {
                f"{name}{end}": report_row[f"joint_ade{end}"] for end in ends
            }
    lines = [
        line.split("&") for line in format_table(rows_frame(rows), "latex").splitlines()
    ]
    columns = zip(*(cells for cells in lines if len(cells) == 7))
    widths = [max(map(points, column)) for column in columns]
    assert len(widths) == 7
    assert sum(widths) + 6 * (len(widths) - 1) < 241


def test_from_a_pandas_frame_to_a_latex_table_in_six_lines(tmp_path, monkeypatch):
    """The lines of docs/evaluate.md, run; and the rows go back to pandas."""
    pandas = pytest.importorskip("pandas")
    page = (ROOT / "docs/evaluate.md").read_text()
    (code,) = re.findall(r"```python\n(import pandas.*?)```", page, re.DOTALL)
    assert len([line for line in code.splitlines() if line]) <= 6
    stamp, person = (axis.ravel() for axis in np.mgrid[0:20, 0:3])
    frame = {
        "time": 0.4 * stamp,
        "person": person,
        "x": 0.5 * stamp,
        "y": person + 0.1 * stamp,
    }
    monkeypatch.chdir(tmp_path)
    pandas.DataFrame(frame).to_csv("my_tracks.csv", index=False)
    names, printed = {}, io.StringIO()
    with contextlib.redirect_stdout(printed):
        exec(code, names)
    assert (
        f"CV & 1 & {names['rows']['joint_ade'][0]:.3f}"
        in printed.getvalue().replace("\\textbf{", "")
    )
    back = names["rows"].to_pandas()
    assert back["joint_ade"].tolist() == names["rows"]["joint_ade"].to_list()


def test_a_table_fits_the_terminal():
    rows = rows_frame(
        [
            row("constant velocity", "eth", 0.431, p=0.01),
            row("SGAN", "eth", 0.3, "a.pt"),
        ]
    )
    for width in (60, 80):
        lines = [line.rstrip() for line in format_table(rows, width=width).splitlines()]
        note = next(at for at, line in enumerate(lines) if line.startswith("joint: "))
        assert max(map(len, lines[:note])) <= width
        at = lines.index("eth: 8 + 8 steps, 602 scenes, 2253 people")
        assert lines[at + 2].split()[:2] == ["model", "ADE"]
        assert lines[at + 3].startswith("constant velocity  0.431 ±.010  ")
        assert lines[at + 4].startswith("SGAN               0.300 ±.010*")
        assert "own" not in "".join(lines)  # It has no value anywhere.
    assert "by Student's t over 50 blocks of scenes" in lines[-2]
    assert lines[-1].startswith("*: significantly better than every other")


def test_columns_that_do_not_fit_are_in_further_tables():
    """At least one, else as many as fit: with names of 5 characters ADE and k take 5 + 13 + 4."""
    rows = rows_frame([row("SGAN", "eth", 0.3)])
    ade, people, k, rate, delay = heads_in_order = [
        "ADE",
        "in collision",
        "k",
        "a second",
        "in ms",
    ]
    for width, tables in (
        (1, [[name] for name in heads_in_order]),
        (21, [[ade], [people], [k, rate], [delay]]),
        (22, [[ade, k], [people], [rate], [delay]]),
        (99, [heads_in_order]),
    ):
        for complete in (True, False):
            lines = format_table(rows, width=width, whole=complete).splitlines()
            heads = [
                re.split(r"  +", line)[1:]
                for line in lines
                if line.startswith("model ")
            ]
            assert heads == (tables if complete else tables[:1])


def test_markdown_marks_the_best_and_keeps_its_cells_apart():
    text = format_table(rows_frame(ROWS), "markdown")
    assert "| eth | SGAN (3 trainings) | 20 | **0.210** [0.185, 0.235] |" in text
    assert text.count("**") == 4
    rows = [["a|b", "1"], ["two\nlines", "2"]]
    assert markdown_table(["name", ""], rows, right=1).splitlines() == [
        "| name | |",
        "|---|---:|",
        r"| a\|b | 1 |",
        "| two lines | 2 |",
    ]
