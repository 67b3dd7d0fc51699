"""The page and its figures, of the table of runs."""

from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from scipy.stats import sem, t

from neurosym_jax.evaluation.markdown import markdown_table
from neurosym_jax.plotting.style import INK, LABEL, SMALL, WIDTH, dress, new_figure, save_figure
from neurosym_jax.runtime.files import write_text
from studies.weighting.arms import CONTROLS, REAL, TENTHS
from studies.weighting.comparison import (
    INTERACTING,
    LEVEL,
    MARGIN,
    Comparison,
    Runs,
    adjusted,
    answer,
)
from studies.weighting.scores import EVENTS
from studies.weighting.text import ANSWER, TEXT

__all__ = ["write"]

QUESTIONS = (
    ("papers, quantised", "papers"),
    ("anchors, symbols", "anchors, nothing"),
    ("anchors, both", "anchors, geometry"),
)
"""The primary comparisons, on each real data set."""
FURTHER = (
    *(("papers, none", "papers"), ("papers, quantised", "papers, none"), ("papers, cnd", "papers")),
    *(("papers, shuffled", "papers"), ("papers, learned", "papers")),
    *(("papers, quantised", "papers, shuffled"), ("papers, quantised", "papers, cnd")),
    *(("anchors, geometry", "anchors, nothing"), ("encounter, quantised", "encounter")),
)
EVERY_STEP = (
    ("encounter, every step, quantised", "encounter, every step"),
    ("encounter, every step", "encounter"),
)
INPUTS = (
    ("without symbols", ("anchors, nothing", "anchors, geometry")),
    ("with symbols", ("anchors, symbols", "anchors, both")),
)
"""Lines of the 2 x 2: arms without and with geometry."""


def write(table: Path) -> None:
    """Write `weighting.md` and its three figures beside `table`."""
    runs = Runs(table)
    primary = adjusted([each for pair in QUESTIONS for each in _on(runs, REAL, pair)])
    further = [each for pair in FURTHER for each in _on(runs, REAL, pair)]
    strata = [
        each
        for pair in QUESTIONS[1:]
        for event in EVENTS
        for each in _on(runs, REAL, pair, f"{event} joint_ade")
    ]
    every = [each for pair in EVERY_STEP for each in _on(runs, REAL, pair)]
    tenths = list(_on(runs, TENTHS, QUESTIONS[2]))
    weak = list(_on(runs, list(CONTROLS)[1:], ("encounter, right", "encounter")))
    save_figure(_forest([*primary, *further], "interacting people"), table.with_suffix(".png"))
    save_figure(_inputs(runs), table.with_name("weighting_inputs.png"))
    save_figure(_forest(strata, "people of an event"), table.with_name("weighting_events.png"))
    text = TEXT.format(
        answer=ANSWER,
        primary=_questions(primary),
        further=_table(further),
        every=_table(every),
        tenths=_table(tenths),
        weak=_table(weak),
        dead="; ".join(
            f"{dead} of {count} of `{arm}` on {name}"
            for name, arm, dead, count in runs.dead.iter_rows()
        )
        or "none",
        diverged="; ".join(
            f"`{run['arm']}` on {run['set']}, seed {run['seed']} ({run['value']:.2f} m)"
            for run in runs.diverged.iter_rows(named=True)
        )
        or "none",
    )
    write_text(table.with_suffix(".md"), text)


def _on(
    runs: Runs, sets: Iterable[str], pair: tuple[str, str], metric: str = INTERACTING
) -> list[Comparison]:
    found = (runs.compare(name, *pair, metric) for name in sets)
    return [each for each in found if each is not None]


def _questions(comparisons: Sequence[Comparison]) -> str:
    """A row for each primary comparison, with its answer."""
    rows = [
        [
            each.dataset,
            f"{each.arm} − {each.reference}",
            str(each.seeds),
            _percent(each),
            _p(each.p),
            _p(each.p_equivalent),
            f"{each.reach:.1f}",
            f"**{answer(each)}**",
        ]
        for each in comparisons
    ]
    head = ["data", "arms", "seeds", "difference, %", "p, different", f"p, within {MARGIN:g} %"]
    return markdown_table([*head, "margin in reach, %", "answer"], rows, right=6)


def _table(comparisons: Sequence[Comparison]) -> str:
    """A row for each pair of arms, a column for each data set; bold: within the margin."""
    sets = list(dict.fromkeys(each.dataset for each in comparisons))
    rows: dict[tuple[str, str], dict[str, Comparison]] = {}
    for each in comparisons:
        rows.setdefault((each.arm, each.reference), {})[each.dataset] = each
    lines = []
    for pair, found in rows.items():
        texts = {
            name: f"**{_percent(each)}**" if each.p_equivalent < LEVEL else _percent(each)
            for name, each in found.items()
        }
        seeds = dict.fromkeys(str(each.seeds) for each in found.values())
        cells = (texts.get(name, "") for name in sets)
        lines.append([" − ".join(pair), ", ".join(seeds), *cells])
    return markdown_table(
        ["arms", "seeds", *(f"{name}, %" for name in sets)], lines, right=len(sets)
    )


def _percent(comparison: Comparison) -> str:
    return f"{comparison.percent:+.1f} ± {comparison.half:.1f}".replace("-", "−")


def _p(value: float) -> str:
    return "< .001" if value < 0.001 else f"{value:.3f}".removeprefix("0")


def _inputs(runs: Runs) -> Figure:
    """The 2 x 2 of an attention's inputs: errors with intervals over seeds, a panel a data set."""
    figure, grid = new_figure(WIDTH, 2.4, 1, len(REAL), sharey=True)
    for axes, name in zip(grid[0], REAL):
        dress(axes)
        axes.set_title(name, fontsize=LABEL, color=INK, loc="left")
        for shift, (label, arms) in enumerate(INPUTS):
            found = [list(runs.values(name, arm, INTERACTING).values()) for arm in arms]
            means = [np.mean(each) for each in found]
            halves = [t.ppf(0.975, len(each) - 1) * sem(each) for each in found]
            places = np.arange(2) + 0.04 * shift
            axes.errorbar(places, means, halves, label=label, marker="D", ms=4, capsize=3)
        axes.set_xticks([0, 1], ["no geometry", "geometry"], fontsize=SMALL, color=INK)
        axes.set_xlim(-0.4, 1.4)
    grid[0, 0].set_ylabel("joint ADE of\ninteracting people, m", fontsize=LABEL, color=INK)
    grid[0, 0].legend(fontsize=SMALL)
    return figure


def _forest(comparisons: Sequence[Comparison], people: str) -> Figure:
    """Differences in per cent with their intervals, a panel a data set, and the margin's band."""
    rows = list(dict.fromkeys((each.arm, each.reference, each.metric) for each in comparisons))
    figure, grid = new_figure(WIDTH, 0.9 + 0.22 * len(rows), 1, len(REAL), sharey=True, sharex=True)
    for axes, name in zip(grid[0], REAL):
        dress(axes)
        axes.set_title(name, fontsize=LABEL, color=INK, loc="left")
        axes.axvspan(-MARGIN, MARGIN, color="#EEEEEE", lw=0, zorder=0)
        axes.axvline(0, color="#888888", lw=0.8, zorder=1)
        for each in (each for each in comparisons if each.dataset == name):
            place = rows.index((each.arm, each.reference, each.metric))
            ends = [each.percent - each.half, each.percent + each.half]
            color = "#0072B2" if each.answered else "#AAAAAA"
            axes.plot(ends, [place, place], color=color, lw=1.8, solid_capstyle="butt")
            axes.plot(each.percent, place, color=color, marker="D", ms=2.5, ls="none")
        axes.grid(visible=False, axis="y")
        axes.locator_params(axis="x", nbins=6)
    several = len({metric for *_, metric in rows}) > 1
    labels = [
        f"{arm} − {reference}" + f" ({metric.split()[0]})" * several
        for arm, reference, metric in rows
    ]
    grid[0, 0].set_yticks(range(len(rows)), labels, fontsize=SMALL, color=INK)
    grid[0, 0].set_ylim(len(rows) - 0.4, -0.6)
    words = f"difference in joint ADE of {people}, %; left: better"
    figure.supxlabel(words, fontsize=LABEL, color=INK)
    return figure
