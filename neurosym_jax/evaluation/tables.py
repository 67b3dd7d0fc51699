"""An evaluation's rows as tables: for a terminal, and as CSV, Markdown and LaTeX for a paper."""

import itertools
import shutil
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Literal, NamedTuple

import polars as pl

from neurosym_jax.errors import printable
from neurosym_jax.evaluation.intervals import FEWEST
from neurosym_jax.evaluation.markdown import (
    aligned_table,
    latex_text,
    markdown_table,
    markdown_text,
)
from neurosym_jax.evaluation.metrics import Metric, known_metric
from neurosym_jax.evaluation.summary import labels, short_names, summarise

__all__ = ["Style", "format_table"]

Style = Literal["text", "csv", "markdown", "latex"]


class Cell(NamedTuple):
    """A mean as text, and what is known of it."""

    mean: str = "-"
    interval: str = ""
    half: str = ""
    """Half of the interval, of a metric in metres or without a unit."""
    best: bool = False
    """Whether it is significantly the best of its test set."""


class Line(NamedTuple):
    """A model on a test set."""

    label: str
    facts: Mapping[str, Any]
    """The columns of `summarise` that all metrics share."""
    cells: Mapping[str, Cell]
    """By metric."""


def format_table(
    rows: pl.DataFrame,
    style: Style = "text",
    width: int | None = None,
    *,
    intervals: bool = False,
    whole: bool = True,
) -> str:
    """Rows as tables: one for each test set and horizon and, of several, one of their means.

    Args:
        rows: see `evaluate`; runs whose checkpoints differ in `seed0`, `seed1`, ... are one line.
        style: text for a terminal; csv, markdown or latex for a paper.
        width: columns of a terminal; default: the terminal's.
        intervals: whether latex has intervals, too, which is too wide for one column of a paper.
        whole: whether text has columns that do not fit in further tables, and a table of means.
    """
    lines = summarise(rows).with_columns(
        pl.col("dataset", "model", "checkpoint").map_elements(printable, pl.String)
    )
    if style == "text":
        shown = lines if whole else lines.filter(pl.col("sets") == 1)
        return "\n".join([_text_tables(shown, width, whole), *_notes(lines)])
    if style == "latex":
        return _latex_table(lines, intervals)
    return _csv_table(lines) if style == "csv" else _markdown_table(lines)


def _text_tables(lines: pl.DataFrame, width: int | None, whole: bool) -> str:
    """A table for each test set, see `format_table`; columns that do not fit are in further ones
    or, unless `whole`, left out."""
    width = width or shutil.get_terminal_size().columns
    texts = []
    for metrics, members in _by_test_set(lines):
        of = members[0].facts
        counts = f", {of['scenes']} scenes, {of['agents']} people" * (of["sets"] == 1)
        title = [f"{of['dataset']}: {of['obs_len']} + {of['pred_len']} steps{counts}"]
        models, *rest = _columns(metrics, members)
        while rest:
            taken, left = [models], width - len(models[0])
            for column in list(rest):
                # At least one column, however narrow the terminal is.
                if len(column[0]) + 2 <= left or len(taken) == 1:
                    taken.append(column)
                    rest.remove(column)
                    left -= len(column[0]) + 2
            texts.append("\n".join([*title, aligned_table(list(zip(*taken))), ""]))
            title = []
            rest = rest if whole else []
    return "\n".join(texts)


def _columns(metrics: Mapping[str, Metric], members: Sequence[Line]) -> list[list[str]]:
    """Cells of equal width of each column, two rows of head first."""
    columns = []
    for name, metric in metrics.items():
        of_metric = [line.cells[name] for line in members]
        unmarked = " " if any(cell.best for cell in of_metric) else ""
        cells = [cell.mean + cell.half + ("*" if cell.best else unmarked) for cell in of_metric]
        first, _, rest = metric.title.partition(" ")
        columns.append([first, rest, *cells] if rest else ["", first, *cells])
    heads = (("", "k"), ("forecasts", "a second"), ("latency", "in ms"))
    facts = [
        (
            line.facts["samples"],
            _rounded(line.facts["forecasts_per_second"], 0),
            _rounded(line.facts["latency"], 1, 1000),
        )
        for line in members
    ]
    columns += [[*head, *map(str, cells)] for head, cells in zip(heads, zip(*facts))]
    right = [[cell.rjust(max(map(len, column))) for cell in column] for column in columns]
    models = ["", "model", *(line.label for line in members)]
    return [[cell.ljust(max(map(len, models))) for cell in models], *right]


def _rounded(value: float | None, decimals: int, scale: float = 1) -> str:
    """`value` in other units; `-` for none."""
    return "-" if value is None else f"{scale * value:.{decimals}f}"


def _csv_table(lines: pl.DataFrame) -> str:
    """A line each, with unrounded numbers; `_low` and `_high` bound the 95 % interval, `_p` is of
    the paired test against the best."""
    facts = ["dataset", "obs_len", "pred_len", "model", "checkpoint", "trainings", "samples"]
    facts += ["seeds", "scenes", "agents", "blocks"]
    values = {"mean": "", "low": "_low", "high": "_high", "std": "_std", "p": "_p"}
    wide = lines.pivot("metric", index=["line", *facts], values=list(values), maintain_order=True)
    columns = [
        pl.col(f"{value}_{metric}").alias(f"{metric}{ending}")
        for metric in lines["metric"].unique(maintain_order=True)
        for value, ending in values.items()
    ]
    return wide.select(*facts, *columns).write_csv()


def _markdown_table(lines: pl.DataFrame) -> str:
    """Means with 95 % intervals; the significantly best is bold."""
    metrics = _metrics(lines)
    heads = [each.title if each.unit == "share" else each.label for each in metrics.values()]
    body = [
        [
            *map(markdown_text, (facts["dataset"], label)),
            str(facts["samples"]),
            *(_bold(cells[name]) for name in metrics),
        ]
        for _, members in _by_test_set(lines)
        for label, facts, cells in members
    ]
    return markdown_table(["", "", "k", *heads], body, right=len(heads) + 1)


def _bold(cell: Cell) -> str:
    return (f"**{cell.mean}**" if cell.best else cell.mean) + cell.interval


def _latex_table(lines: pl.DataFrame, intervals: bool) -> str:
    """A `tabular` of booktabs for one column of a paper: the significantly best mean is bold."""
    metrics = _metrics(lines)
    tests = [members for _, members in _by_test_set(lines)]
    titles = [metric.title.partition(" ") for metric in metrics.values()]
    above, below = ["", ""], ["", "$k$"]
    for first, parts in itertools.groupby(titles, lambda title: title[0] if title[2] else ""):
        rests = [rest or word for word, _, rest in parts]
        above.append(rf"\multicolumn{{{len(rests)}}}{{c}}{{{latex_text(first)}}}")
        below += map(latex_text, rests)
    short = short_names(line.label for of_test in tests for line in of_test)
    rows = []
    for of_test in tests:
        of = of_test[0].facts
        title = latex_text(f"{of['dataset']}, {of['obs_len']} + {of['pred_len']} steps")
        rows += [r"\midrule", rf"\multicolumn{{{len(below)}}}{{l}}{{\emph{{{title}}}}} \\"]
        for label, of, found in of_test:
            cells = [latex_text(short[label]), str(of["samples"])]
            for mean, interval, _, best in map(found.__getitem__, metrics):
                text = rf"\textbf{{{latex_text(mean)}}}" if best else latex_text(mean)
                cells.append(text + rf"{{\scriptsize{interval}}}" * (intervals and bool(interval)))
            rows.append(" & ".join(cells) + r" \\")
    named = [f"{brief}: {name}" for name, brief in short.items() if brief != name]
    units = ["errors in metres"] * any(metric.unit == "m" for metric in metrics.values())
    return "\n".join(
        [
            r"% \usepackage{booktabs}",
            *(f"% {note}" for note in [*named, *units, *_notes(lines, intervals)]),
            r"\begingroup\footnotesize\setlength{\tabcolsep}{3pt}",
            rf"\begin{{tabular}}{{@{{}}l{'r' * (len(below) - 1)}@{{}}}}",
            r"\toprule",
            " & ".join(above) + r" \\",
            " & ".join(below) + r" \\",
            *rows,
            r"\bottomrule",
            r"\end{tabular}\endgroup",
        ]
    )


def _cell(metric: Metric, value: Mapping[str, Any]) -> Cell:
    """The cell of a row of `summarise`."""
    if value["mean"] is None:
        return Cell()
    mean = metric.text(value["mean"])
    if value["low"] is None:
        few = value["sets"] == 1 and value["blocks"] < FEWEST
        return Cell(mean, " [too few blocks]" * few)
    low, high = (metric.text(value[end]).split(" ")[0] for end in ("low", "high"))
    half = f" ±{(value['high'] - value['low']) / 2:.3f}".replace("±0.", "±.")
    return Cell(mean, f" [{low}, {high}]", half * (metric.unit in ("", "m")), value["best"])


def _notes(lines: pl.DataFrame, intervals: bool | None = None) -> list[str]:
    """Explanations below a table for a terminal or, given whether it has `intervals`, a paper."""
    found = [metric.about for metric in _metrics(lines).values()]
    single = lines.filter(pl.col("trainings") == 1)["blocks"].drop_nulls().unique().sort().to_list()
    if single and intervals is not False:
        interval = "[ ]: 95 % interval" if intervals else "±: half of a 95 % interval"
        number = f"{single[0]}" if len(single) == 1 else f"{single[0]} to {single[-1]}"
        found.append(f"{interval} by Student's t over {number} blocks of scenes")
        if single[0] < FEWEST:
            found.append(f"fewer than {FEWEST} blocks say nothing: no interval, no test")
    if several := lines.filter(pl.col("trainings") > 1)["trainings"].unique().sort().to_list():
        number = ", ".join(map(str, several))
        found.append(f"{number} trainings: Student's interval of their mean instead")
    if lines["best"].any():
        mark = "*" if intervals is None else "bold"
        found.append(f"{mark}: significantly better than every other (paired tests, 5 %, Holm)")
    return [printable(note) for note in dict.fromkeys(found) if note]


def _by_test_set(lines: pl.DataFrame) -> Iterator[tuple[dict[str, Metric], list[Line]]]:
    """The metrics that have a value on each test set, and its lines."""
    for _, of in lines.group_by("dataset", "obs_len", "pred_len", maintain_order=True):
        values = [line.to_dicts() for _, line in of.group_by("line", maintain_order=True)]
        names = labels([(each[0]["model"], each[0]["checkpoint"]) for each in values])
        members = []
        for name, each in zip(names, values):
            trainings = each[0]["trainings"]
            label = name + f" ({trainings} trainings)" * (trainings > 1)
            cells = {value["metric"]: _cell(known_metric(value["metric"]), value) for value in each}
            members.append(Line(label, each[0], cells))
        yield _metrics(of), members


def _metrics(lines: pl.DataFrame) -> dict[str, Metric]:
    """The metrics of which some line has a value."""
    known = lines.filter(pl.col("mean").is_not_null())["metric"].unique(maintain_order=True)
    return {name: known_metric(name) for name in known}
