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
        rows: see `evaluate`; runs whose checkpoints differ in `seed0`, `seed1`, ... are
            one line.
        style: text for a terminal; csv, markdown or latex for a paper.
        width: columns of a terminal; default: the terminal's.
        intervals: whether latex has intervals, too, which is too wide for one column of
            a paper.
        whole: whether text has columns that do not fit in further tables, and a table
            of means.
    """
    lines = summarise(rows).with_columns(
        pl.col("dataset", "model", "checkpoint").map_elements(printable, pl.String)
    )
    if style == "text":
        visible = lines if whole else lines.filter(pl.col("sets") == 1)
        return "\n".join([_text_tables(visible, width, whole), *_notes(lines)])
    if style == "latex":
        return _latex_table(lines, intervals)
    return _csv_table(lines) if style == "csv" else _markdown_table(lines)


def _text_tables(lines: pl.DataFrame, width: int | None, whole: bool) -> str:
    """A table for each test set, see `format_table`; columns that do not fit are in further ones
    or, unless `whole`, left out."""
    width = width or shutil.get_terminal_size().columns
    texts = []
    for metrics, members in _by_test_set(lines):
        facts = members[0].facts
        counts = f", {facts['scenes']} scenes, {facts['agents']} people" * (
            facts["sets"] == 1
        )
        title = [
            f"{facts['dataset']}: {facts['obs_len']} + {facts['pred_len']} steps{counts}"
        ]
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
        column_cells = [line.cells[name] for line in members]
        unmarked = " " if any(cell.best for cell in column_cells) else ""
        cells = [
            cell.mean + cell.half + ("*" if cell.best else unmarked)
            for cell in column_cells
        ]
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
    right = [
        [cell.rjust(max(map(len, column))) for cell in column] for column in columns
    ]
    models = ["", "model", *(line.label for line in members)]
    return [[cell.ljust(max(map(len, models))) for cell in models], *right]


def _rounded(value: float | None, decimals: int, scale: float = 1) -> str:
    """`value` in other units; `-` for none."""
    return "-" if value is None else f"{scale * value:.{decimals}f}"


def _csv_table(lines: pl.DataFrame) -> str:
    """A line each, with unrounded numbers; `_low` and `_high` bound the 95 % interval, `_p` is of
    the paired test against the best."""
    facts = [
        "dataset",
        "obs_len",
        "pred_len",
        "model",
        "checkpoint",
        "trainings",
        "samples",
    ]
    facts += ["seeds", "scenes", "agents", "blocks"]
    values = {"mean": "", "low": "_low", "high": "_high", "std": "_std", "p": "_p"}
    wide = lines.pivot(
        "metric", index=["line", *facts], values=list(values), maintain_order=True
    )
    columns = [
        pl.col(f"{value}_{metric}").alias(f"{metric}{ending}")
        for metric in lines["metric"].unique(maintain_order=True)
        for value, ending in values.items()
    ]
    return wide.select(*facts, *columns).write_csv()


def _markdown_table(lines: pl.DataFrame) -> str:
    """Means with 95 % intervals; the significantly best is bold."""
    metrics = _metrics(lines)
    heads = [
        metric.title if metric.unit == "share" else metric.label
        for metric in metrics.values()
    ]
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
    for first, parts in itertools.groupby(
        titles, lambda title: title[0] if title[2] else ""
    ):
        rests = [rest or word for word, _, rest in parts]
        above.append(rf"\multicolumn{{{len(rests)}}}{{c}}{{{latex_text(first)}}}")
        below += map(latex_text, rests)
    short = short_names(line.label for members in tests for line in members)
    rows = []
    for members in tests:
        facts = members[0].facts
        title = latex_text(
            f"{facts['dataset']}, {facts['obs_len']} + {facts['pred_len']} steps"
        )
        rows += [
            r"\midrule",
            rf"\multicolumn{{{len(below)}}}{{l}}{{\emph{{{title}}}}} \\",
        ]
        for label, facts, cells_by_metric in members:
            cells = [latex_text(short[label]), str(facts["samples"])]
            for mean, interval, _, best in map(cells_by_metric.__getitem__, metrics):
                text = rf"\textbf{{{latex_text(mean)}}}" if best else latex_text(mean)
                cells.append(
                    text
                    + rf"{{\scriptsize{interval}}}" * (intervals and bool(interval))
                )
            rows.append(" & ".join(cells) + r" \\")
    named = [f"{brief}: {name}" for name, brief in short.items() if brief != name]
    units = ["errors in metres"] * any(
        metric.unit == "m" for metric in metrics.values()
    )
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
    return Cell(
        mean, f" [{low}, {high}]", half * (metric.unit in ("", "m")), value["best"]
    )


def _notes(lines: pl.DataFrame, intervals: bool | None = None) -> list[str]:
    """Explanations below a table for a terminal or, given whether it has `intervals`, a paper."""
    notes = [metric.about for metric in _metrics(lines).values()]
    single = (
        lines.filter(pl.col("trainings") == 1)["blocks"]
        .drop_nulls()
        .unique()
        .sort()
        .to_list()
    )
    if single and intervals is not False:
        interval = "[ ]: 95 % interval" if intervals else "±: half of a 95 % interval"
        number = f"{single[0]}" if len(single) == 1 else f"{single[0]} to {single[-1]}"
        notes.append(f"{interval} by Student's t over {number} blocks of scenes")
        if single[0] < FEWEST:
            notes.append(
                f"fewer than {FEWEST} blocks say nothing: no interval, no test"
            )
    if (
        counts := lines.filter(pl.col("trainings") > 1)["trainings"]
        .unique()
        .sort()
        .to_list()
    ):
        number = ", ".join(map(str, counts))
        notes.append(f"{number} trainings: Student's interval of their mean instead")
    if lines["best"].any():
        mark = "*" if intervals is None else "bold"
        notes.append(
            f"{mark}: significantly better than every other (paired tests, 5 %, Holm)"
        )
    return [printable(note) for note in dict.fromkeys(notes) if note]


def _by_test_set(lines: pl.DataFrame) -> Iterator[tuple[dict[str, Metric], list[Line]]]:
    """The metrics that have a value on each test set, and its lines."""
    for _, rows in lines.group_by(
        "dataset", "obs_len", "pred_len", maintain_order=True
    ):
        groups = [
            line.to_dicts() for _, line in rows.group_by("line", maintain_order=True)
        ]
        names = labels([(first["model"], first["checkpoint"]) for first, *_ in groups])
        members = []
        for name, values in zip(names, groups):
            facts = values[0]
            trainings = facts["trainings"]
            label = name + f" ({trainings} trainings)" * (trainings > 1)
            cells = {
                value["metric"]: _cell(known_metric(value["metric"]), value)
                for value in values
            }
            members.append(Line(label, facts, cells))
        yield _metrics(rows), members


def _metrics(lines: pl.DataFrame) -> dict[str, Metric]:
    """The metrics of which some line has a value."""
    names = lines.filter(pl.col("mean").is_not_null())["metric"].unique(
        maintain_order=True
    )
    return {name: known_metric(name) for name in names}
