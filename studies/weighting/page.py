"""The page and its figures, of the table of runs."""

from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np
import polars as pl
from matplotlib.figure import Figure
from scipy.stats import sem, t

from neurosym_jax.evaluation.markdown import markdown_table
from neurosym_jax.plotting.style import (
    INK,
    LABEL,
    SMALL,
    WIDTH,
    dress,
    new_figure,
    save_figure,
)
from neurosym_jax.runtime.files import write_text
from studies.history import report
from studies.weighting.arms import CONTROLS, PLACES, REAL, TENTHS
from studies.weighting.comparison import (
    ENERGY,
    INTERACTING,
    LEVEL,
    MARGIN,
    Comparison,
    Runs,
    adjusted,
    answer,
    compared,
    p_text,
    percent_text,
)
from studies.weighting.scores import EVENTS
from studies.weighting.text import ANSWER, TEXT

__all__ = ["places", "write"]

QUESTIONS = (
    ("papers, quantised", "papers"),
    ("anchors, symbols", "anchors, nothing"),
    ("anchors, both", "anchors, geometry"),
)
"""The primary comparisons, on each real data set."""
FURTHER = (
    *(
        ("papers, none", "papers"),
        ("papers, quantised", "papers, none"),
        ("papers, cnd", "papers"),
    ),
    *(("papers, shuffled", "papers"), ("papers, learned", "papers")),
    *(("papers, quantised", "papers, shuffled"), ("papers, quantised", "papers, cnd")),
    *(("anchors, geometry", "anchors, nothing"), ("encounter, quantised", "encounter")),
)
WEIGHTS = (("papers, quantised", "papers"), ("papers, quantised", "papers, shuffled"))
"""The comparisons of the protocol's fourth part."""
NAMES = {INTERACTING: "joint ADE", ENERGY: "energy score"}
SEEDS_OF_PLACES, MANY = 4, 50
"""Of each arm at a place; and the people from which on a place is no matter of luck."""
INPUTS = (
    ("without symbols", ("anchors, nothing", "anchors, geometry")),
    ("with symbols", ("anchors, symbols", "anchors, both")),
)
"""Lines of the 2 x 2: arms without and with geometry."""


def write(table: Path) -> None:
    """Write `weighting.md` and its figures beside `table` and that of `studies.history`."""
    runs = Runs(pl.read_csv(table))
    primary = adjusted(_on(runs, REAL, QUESTIONS))
    further = _on(runs, REAL, FURTHER)
    energy = _on(runs, REAL, FURTHER, ENERGY)
    primary_energy = _on(runs, REAL, QUESTIONS, ENERGY)
    strata = [
        comparison
        for pair in QUESTIONS[1:]
        for event in EVENTS
        for comparison in _on(runs, REAL, [pair], f"{event} joint_ade")
    ]
    tenths = _on(runs, TENTHS, QUESTIONS[2:])
    weak = _on(runs, CONTROLS, [("encounter, right", "encounter")])
    save_figure(
        _forest([*primary, *further], "interacting people"), table.with_suffix(".png")
    )
    save_figure(_inputs(runs), table.with_name("weighting_inputs.png"))
    save_figure(
        _forest(strata, "people of an event"), table.with_name("weighting_events.png")
    )
    text = TEXT.format(
        answer=ANSWER,
        primary=_questions(primary, primary_energy),
        further=_table([*further, *energy]),
        places=places(pl.read_csv(table)),
        history=report(pl.read_csv(table.with_name("history.csv"))),
        tenths=_table(tenths),
        weak=_table(weak),
        dead="; ".join(
            f"{dead} of {count} `{arm}` on {name}"
            for name, arm, dead, count in runs.dead.iter_rows()
        )
        or "none",
    )
    write_text(table.with_suffix(".md"), text)


def _on(
    runs: Runs,
    sets: Iterable[str],
    pairs: Iterable[tuple[str, str]],
    metric: str = INTERACTING,
) -> list[Comparison]:
    """The comparison of each pair of arms on each data set that has enough runs of both."""
    comparisons = (runs.compare(name, *pair, metric) for pair in pairs for name in sets)
    return [comparison for comparison in comparisons if comparison is not None]


def _questions(comparisons: Sequence[Comparison], energy: Sequence[Comparison]) -> str:
    """A row for each primary comparison, with its answer, and the same by the energy score."""
    rows = [
        [
            comparison.dataset,
            f"{comparison.arm} − {comparison.reference}",
            str(comparison.seeds),
            percent_text(comparison),
            p_text(comparison.p),
            p_text(comparison.p_equivalent),
            f"{comparison.reach:.1f}",
            f"**{answer(comparison)}**",
            _cell(secondary),
        ]
        for comparison, secondary in zip(comparisons, energy)
    ]
    head = [
        "data",
        "arms",
        "seeds",
        "joint ADE, %",
        "p, different",
        f"p, within {MARGIN:g} %",
    ]
    head += ["margin in reach, %", "answer", "energy score, %"]
    return markdown_table(head, rows, right=7)


def places(rows: pl.DataFrame) -> str:
    """The comparisons of weights at each place and, tested, their means over places.

    Places with too few runs are left out. Only the planned means are corrected (Holm).
    """
    runs = Runs(rows.filter(pl.col("seed") < SEEDS_OF_PLACES))
    columns = [
        (*pair, name) for pair in WEIGHTS for name in ("joint_ade", "energy_score")
    ]

    def of(place: str, people: str) -> list[Comparison]:
        found = (
            runs.compare(place, *pair, f"{people} {metric}")
            for *pair, metric in columns
        )
        return [comparison for comparison in found if comparison is not None]

    def means(lines: Iterable[list[Comparison]]) -> list[Comparison]:
        return [
            compared(
                "mean",
                *column,
                np.array([comparison.percent for comparison in of_places]),
            )
            for column, of_places in zip(columns, zip(*lines))
        ]

    counts = (
        rows.filter(metric=INTERACTING).group_by("set").agg(pl.col("counted").max())
    )
    people = dict(counts.iter_rows())
    lines = {name: of(name, "interacting") for name in PLACES + REAL}
    lines = {name: line for name, line in lines.items() if len(line) == len(columns)}
    many = (line for name, line in lines.items() if people[name] >= MANY)
    table = [
        [name, f"{people[name]:,}", *map(percent_text, line)]
        for name, line in lines.items()
    ]
    table += [
        ["mean", "", *map(_tested, adjusted(means(lines.values())))],
        [f"{MANY} people or more", "", *map(percent_text, means(many))],
        [
            "all people",
            "",
            *map(percent_text, means(of(name, "all") for name in lines)),
        ],
    ]
    pairs = [
        " − ".join(arm.removeprefix("papers, ") for arm in pair) for *pair, _ in columns
    ]
    names = [NAMES[f"interacting {name}"] for *_, name in columns]
    head = [f"{pair}, {name}, %" for pair, name in zip(pairs, names)]
    return markdown_table(["place", "people", *head], table, right=5)


def _tested(comparison: Comparison) -> str:
    return f"{percent_text(comparison)} **{answer(comparison)}**"


def _table(comparisons: Sequence[Comparison]) -> str:
    """A row for each pair of arms, a column a metric and data set; bold: within the margin."""
    columns = list(dict.fromkeys((item.metric, item.dataset) for item in comparisons))
    rows: dict[tuple[str, str], dict[tuple[str, str], Comparison]] = {}
    for item in comparisons:
        rows.setdefault((item.arm, item.reference), {})[item.metric, item.dataset] = (
            item
        )
    lines = []
    for pair, row in rows.items():
        seeds = dict.fromkeys(str(item.seeds) for item in row.values())
        cells = (_cell(row[column]) if column in row else "" for column in columns)
        lines.append([" − ".join(pair), ", ".join(seeds), *cells])
    heads = [f"{name}, {NAMES.get(metric, metric)}, %" for metric, name in columns]
    return markdown_table(["arms", "seeds", *heads], lines, right=len(columns))


def _cell(comparison: Comparison) -> str:
    text = percent_text(comparison)
    return f"**{text}**" if comparison.p_equivalent < LEVEL else text


def _inputs(runs: Runs) -> Figure:
    """The 2 x 2 of an attention's inputs: errors with intervals over seeds, a panel a data set."""
    figure, grid = new_figure(WIDTH, 2.4, 1, len(REAL), sharey=True)
    for axes, name in zip(grid[0], REAL):
        dress(axes)
        axes.set_title(name, fontsize=LABEL, color=INK, loc="left")
        for shift, (label, arms) in enumerate(INPUTS):
            errors = [
                list(runs.values(name, arm, INTERACTING).values()) for arm in arms
            ]
            means = list(map(np.mean, errors))
            halves = [t.ppf(0.975, len(values) - 1) * sem(values) for values in errors]
            places = np.arange(2) + 0.04 * shift
            axes.errorbar(
                places, means, halves, label=label, marker="D", ms=4, capsize=3
            )
        axes.set_xticks([0, 1], ["no geometry", "geometry"], fontsize=SMALL, color=INK)
        axes.set_xlim(-0.4, 1.4)
    grid[0, 0].set_ylabel(
        "joint ADE of\ninteracting people, m", fontsize=LABEL, color=INK
    )
    grid[0, 0].legend(fontsize=SMALL)
    return figure


def _forest(comparisons: Sequence[Comparison], people: str) -> Figure:
    """Differences in per cent with their intervals, a panel a data set, and the margin's band."""
    rows = list(dict.fromkeys(map(_row, comparisons)))
    figure, grid = new_figure(
        WIDTH, 0.9 + 0.22 * len(rows), 1, len(REAL), sharey=True, sharex=True
    )
    for axes, name in zip(grid[0], REAL):
        dress(axes)
        axes.set_title(name, fontsize=LABEL, color=INK, loc="left")
        axes.axvspan(-MARGIN, MARGIN, color="#EEEEEE", lw=0, zorder=0)
        axes.axvline(0, color="#888888", lw=0.8, zorder=1)
        for comparison in comparisons:
            if comparison.dataset != name:
                continue
            place, percent, half = (
                rows.index(_row(comparison)),
                comparison.percent,
                comparison.half,
            )
            ends = [percent - half, percent + half]
            color = "#0072B2" if comparison.answered else "#AAAAAA"
            axes.plot(ends, [place, place], color=color, lw=1.8, solid_capstyle="butt")
            axes.plot(percent, place, color=color, marker="D", ms=2.5, ls="none")
        axes.grid(visible=False, axis="y")
        axes.locator_params(axis="x", nbins=6)
    many_metrics = len({metric for *_, metric in rows}) > 1
    labels = [
        f"{arm} − {reference}" + f" ({metric.split()[0]})" * many_metrics
        for arm, reference, metric in rows
    ]
    grid[0, 0].set_yticks(range(len(rows)), labels, fontsize=SMALL, color=INK)
    grid[0, 0].set_ylim(len(rows) - 0.4, -0.6)
    words = f"difference in joint ADE of {people}, %; left: better"
    figure.supxlabel(words, fontsize=LABEL, color=INK)
    return figure


def _row(comparison: Comparison) -> tuple[str, str, str]:
    return comparison.arm, comparison.reference, comparison.metric
