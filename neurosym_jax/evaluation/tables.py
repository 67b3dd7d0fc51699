"""Lines of an evaluation as tables: for a terminal, and as CSV, Markdown and LaTeX for a paper."""

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Literal

from neurosym_jax.evaluation.markdown import csv_text, markdown_table
from neurosym_jax.evaluation.metrics import Metric, known_metric
from neurosym_jax.evaluation.paired import Interval
from neurosym_jax.evaluation.summary import Line, Value, told_apart

if TYPE_CHECKING:
    from rich.table import Table
    from rich.text import Text

__all__ = ["Style", "csv_table", "labels", "latex_table", "notes", "paper_markdown", "rich_tables"]

Style = Literal["text", "csv", "markdown", "latex"]

GAP = 2
"""Between two columns of a terminal's table."""
LATEX = {**{sign: f"\\{sign}" for sign in "&%$#_{}"}, "\\": r"\textbackslash{}"}
LATEX |= {"~": r"\textasciitilde{}", "^": r"\textasciicircum{}", "±": r"$\pm$"}


def rich_tables(lines: Sequence[Line], width: int, *, whole: bool = True) -> "list[Table]":
    """Lines of one test set, for a terminal of `width` letters.

    After ± stands half of the 95 % interval; what is better than all others is bold.

    Args:
        lines: of one test set.
        width: what is wider goes on in further tables below.
        whole: whether these are wanted.
    """
    from rich.table import Table

    models, columns = _columns(lines)
    head = max(map(len, (models[0], *map(str, models[1]))))
    tables: list[Table] = []
    rest = columns
    while rest and (whole or not tables):
        taken = [models]
        left = width - head
        for column in list(rest):
            needed = GAP + max(
                len(part) for cell in (column[0], *column[1]) for part in str(cell).split("\n")
            )
            # One column at least, however narrow the terminal is.
            if needed <= left or len(taken) == 1:
                taken.append(column)
                rest.remove(column)
                left -= needed
        title = "" if tables else _title(lines[0])
        table = Table(title=title or None, title_justify="left", title_style="bold", box=None)
        table.pad_edge, table.padding = False, (0, GAP, 0, 0)
        for number, (name, _) in enumerate(taken):
            table.add_column(name, justify="right" if number else "left", vertical="bottom")
        for cells in zip(*(cells for _, cells in taken)):
            table.add_row(*cells)
        tables.append(table)
    return tables


Column = tuple[str, "list[Text]"]
"""Its head, in which a title's first word stands above the others, and its cells."""


def _columns(lines: Sequence[Line]) -> tuple[Column, list[Column]]:
    """That of the models, and those of what is known of them."""
    from rich.text import Text

    columns: list[Column] = [
        (
            metric.title.replace(" ", "\n", 1),
            [_with_half(metric, line.values.get(metric.name)) for line in lines],
        )
        for metric in _metrics(lines)
    ]
    slowest = [max(1000 * row["seconds"]["latency"] for row in line.rows) for line in lines]
    rates = [min(row["forecasts_per_second"] for row in line.rows) for line in lines]
    columns.append(("k", [Text(str(line.rows[0]["samples"])) for line in lines]))
    columns.append(("forecasts\na second", [Text(f"{rate:.0f}") for rate in rates]))
    columns.append(("latency\nin ms", [Text(f"{milliseconds:.1f}") for milliseconds in slowest]))
    return ("model", [Text(label) for label in labels(lines)]), columns


def _title(line: Line) -> str:
    test, row = line.test_set, line.rows[0]
    counts = f", {row['scenes']} scenes, {row['agents']} people" if line.datasets == 1 else ""
    return f"{test.dataset}: {test.obs_len} + {test.pred_len} steps{counts}"


def csv_table(lines: Sequence[Line]) -> str:
    """A line each, numbers as they are; `_low` and `_high` bound the 95 % interval."""
    metrics = _metrics(lines)
    head = ["dataset", "obs_len", "pred_len", "model", "checkpoint", "trainings", "samples"]
    head += ["seeds", "scenes", "agents", "blocks"]
    head += [f"{metric.name}{part}" for metric in metrics for part in ("", "_low", "_high", "_std")]
    rows = [head]
    for line in lines:
        row, test = line.rows[0], line.test_set
        counts = [row["scenes"], row["agents"], row.get("blocks")]
        counts = counts if line.datasets == 1 else [None] * 3
        cells = [test.dataset, test.obs_len, test.pred_len, line.model, line.checkpoint]
        cells += [line.trainings, row["samples"], row.get("seeds", 1), *counts]
        for metric in metrics:
            value = line.values.get(metric.name, Value(None))
            cells += [value.mean, *(value.interval or (None, None)), value.spread]
        rows.append(cells)
    return csv_text(rows)


def paper_markdown(lines: Sequence[Line]) -> str:
    """Means with their 95 % intervals; what is better than all others is bold."""
    metrics = _metrics(lines)
    rows = [
        [line.test_set.dataset, label, k, *(_marked(metric, line, "**{}**") for metric in metrics)]
        for line, label, k in _labelled(lines)
    ]
    return markdown_table(
        ["", "", "k", *(_head(metric) for metric in metrics)], rows, right=len(metrics) + 1
    )


def latex_table(lines: Sequence[Line]) -> str:
    r"""A `tabular` of booktabs: means with 95 % intervals, what is better than all others bold.

    A comment above says which package it needs.
    """
    metrics = _metrics(lines)
    head = ["", "", "$k$", *(_escaped(_head(metric)) for metric in metrics)]
    body, before = [], None
    for line, label, k in _labelled(lines):
        cells = [_marked(metric, line, r"\textbf{{{}}}", latex=True) for metric in metrics]
        test = line.test_set
        new = test != before
        if new and before is not None:
            body.append(r"\midrule")
        name = f"{test.dataset}, {test.obs_len} + {test.pred_len}" if new else ""
        body.append(" & ".join([_escaped(name), _escaped(label), k, *cells]) + r" \\")
        before = test
    columns = "ll" + "r" * (len(metrics) + 1)
    return "\n".join(
        [
            r"% \usepackage{booktabs}",
            *(f"% {note}" for note in notes(lines, paper=True)),
            rf"\begin{{tabular}}{{{columns}}}",
            r"\toprule",
            " & ".join(head) + r" \\",
            r"\midrule",
            *body,
            r"\bottomrule",
            r"\end{tabular}",
        ]
    )


def notes(lines: Sequence[Line], *, paper: bool = False, bold: bool = True) -> list[str]:
    """What a table, for a `paper` or a terminal, says beside its numbers; and of `bold` ones."""
    interval = "[ ]: 95 % interval" if paper else "±: half of a 95 % interval"
    found = [metric.about for metric in _metrics(lines) if metric.about]
    blocks = [line.rows[0].get("blocks") for line in lines if line.trainings == 1]
    counts = sorted({count for count in blocks if count is not None})
    if counts:
        number = f"{counts[0]}" if len(counts) == 1 else f"{counts[0]} to {counts[-1]}"
        found.append(f"{interval} by bootstrap over {number} blocks of scenes")
    if several := sorted({line.trainings for line in lines if line.trainings > 1}):
        found.append(
            f"of {', '.join(map(str, several))} trainings: Student's interval of their mean instead"
        )
    spreads = [
        value.spread
        for line in lines
        if line.trainings == 1
        for name, value in line.values.items()
        if value.spread is not None and known_metric(name).unit == "m"
    ]
    if spreads:
        seeds = lines[0].rows[0]["seeds"]
        found.append(
            f"means of {seeds} seeds of the noise, whose standard deviation is at most "
            f"{max(spreads):.3f} m"
        )
    if bold and any(value.best for line in lines for value in line.values.values()):
        found.append("bold: the interval lies beyond those of all others")
    return list(dict.fromkeys(found))


def labels(lines: Sequence[Line]) -> list[str]:
    """The models of one test set by name and, where several have one name, by checkpoint."""
    names = [line.model for line in lines]
    short = told_apart(line.checkpoint for line in lines if line.checkpoint)
    found = []
    for line in lines:
        label = line.model
        if line.checkpoint and names.count(line.model) > 1:
            label += f" {short[line.checkpoint]}"
        if line.trainings > 1:
            label += f" ({line.trainings} trainings)"
        found.append(label)
    return found


def _labelled(lines: Sequence[Line]) -> Iterator[tuple[Line, str, str]]:
    """Each line with its label among those of its test set, and k."""
    for test in dict.fromkeys(line.test_set for line in lines):
        members = [line for line in lines if line.test_set == test]
        for line, label in zip(members, labels(members)):
            yield line, label, str(line.rows[0]["samples"])


def _metrics(lines: Sequence[Line]) -> list[Metric]:
    """Those of which some line has a value."""
    names = dict.fromkeys(name for line in lines for name in line.values)
    known = [
        name
        for name in names
        if any(line.values.get(name, Value(None)).mean is not None for line in lines)
    ]
    return [known_metric(name) for name in known]


def _head(metric: Metric) -> str:
    """Of a paper's column; per cents stand in its cells."""
    return metric.title if metric.unit == "share" else metric.label


def _with_half(metric: Metric, value: Value | None) -> "Text":
    from rich.text import Text

    value = value or Value(None)
    text = metric.text(value.mean)
    if value.interval is not None and metric.unit in ("", "m"):
        low, high = value.interval
        text += f" ±{(high - low) / 2:.3f}".replace("±0.", "±.")
    return Text(text, style="bold" if value.best else "")


def _marked(metric: Metric, line: Line, bold: str, *, latex: bool = False) -> str:
    value = line.values.get(metric.name, Value(None))
    text = metric.text(value.mean)
    text = _escaped(text) if latex else text
    text = bold.format(text) if value.best else text
    if value.interval is None:
        return text
    bounds = _bounds(metric, value.interval)
    return f"{text} {{\\footnotesize {bounds}}}" if latex else f"{text} {bounds}"


def _bounds(metric: Metric, interval: Interval) -> str:
    low, high = (metric.text(bound).split(" ")[0] for bound in interval)
    return f"[{low}, {high}]"


def _escaped(text: str) -> str:
    return "".join(LATEX.get(letter, letter) for letter in text)
