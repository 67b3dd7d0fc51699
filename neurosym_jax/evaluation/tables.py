"""An evaluation's rows as tables: for a terminal, and as CSV, Markdown and LaTeX for a paper."""

import dataclasses
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Literal

import polars as pl

from neurosym_jax.evaluation.bootstrap import Interval
from neurosym_jax.evaluation.markdown import markdown_table
from neurosym_jax.evaluation.metrics import Metric, known_metric
from neurosym_jax.evaluation.summary import Line, Value, lines_of, means_of, told_apart

if TYPE_CHECKING:
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

__all__ = ["Style", "format_table", "labels", "notes", "show_tables"]

Style = Literal["text", "csv", "markdown", "latex"]

GAP = 2
"""Between two columns of a terminal's table."""
LATEX = {**{sign: f"\\{sign}" for sign in "&%$#_{}"}, "\\": r"\textbackslash{}"}
LATEX |= {"~": r"\textasciitilde{}", "^": r"\textasciicircum{}", "±": r"$\pm$"}


def format_table(rows: pl.DataFrame, style: Style = "text", width: int | None = None) -> str:
    """Rows as tables: one for each test set and horizon and, of several, one of their means.

    Args:
        rows: see `evaluate`; runs whose checkpoints differ in `seed0`, `seed1`, ... are one line.
        style: text for a terminal; csv, markdown or latex for a paper.
        width: columns of a terminal; default: the terminal's.
    """
    lines = lines_of(rows.iter_rows(named=True))
    lines += means_of(lines)
    if style != "text":
        return {"csv": _csv_table, "markdown": _paper_markdown, "latex": _latex_table}[style](lines)
    from rich.console import Console

    # Text in a notebook, too.
    console = Console(width=width, force_jupyter=False, color_system=None)
    with console.capture() as text:
        show_tables(lines, console)
    found = "\n".join(line.rstrip() for line in text.get().splitlines())
    return f"{found}\n" + "\n".join(notes(lines, bold=False))


def show_tables(lines: Sequence[Line], console: "Console", *, whole: bool = True) -> None:
    """Print a table for each test set, `whole` or as many columns as fit the console's width."""
    for test_set in dict.fromkeys(line.test_set for line in lines):
        members = [line for line in lines if line.test_set == test_set]
        for table in _rich_tables(members, console.width, whole=whole):
            console.print(table, "")


def _rich_tables(lines: Sequence[Line], width: int, *, whole: bool = True) -> "list[Table]":
    """A table of one test set; columns beyond `width` are in further tables, if `whole`."""
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
"""Head, in which a title's first word stands above the others, and cells."""


def _columns(lines: Sequence[Line]) -> tuple[Column, list[Column]]:
    """The column of models, and the others."""
    from rich.text import Text

    columns: list[Column] = [
        (
            metric.title.replace(" ", "\n", 1),
            [_with_half(metric, line.values.get(name)) for line in lines],
        )
        for name, metric in _metrics(lines).items()
    ]
    slowest = [max(1000 * row["latency"] for row in line.rows) for line in lines]
    rates = [min(row["forecasts_per_second"] for row in line.rows) for line in lines]
    columns.append(("k", [Text(str(line.rows[0]["samples"])) for line in lines]))
    columns.append(("forecasts\na second", [Text(f"{rate:.0f}") for rate in rates]))
    columns.append(("latency\nin ms", [Text(f"{milliseconds:.1f}") for milliseconds in slowest]))
    return ("model", [Text(label) for label in labels(lines)]), columns


def _title(line: Line) -> str:
    test, row = line.test_set, line.rows[0]
    counts = f", {row['scenes']} scenes, {row['agents']} people" if line.datasets == 1 else ""
    return f"{test.dataset}: {test.obs_len} + {test.pred_len} steps{counts}"


def _csv_table(lines: Sequence[Line]) -> str:
    """A line each, with unrounded numbers; `_low` and `_high` bound the 95 % interval."""
    rows = []
    for line in lines:
        row, one = line.rows[0], line.datasets == 1
        cells = {
            **dataclasses.asdict(line.test_set),
            "model": line.model,
            "checkpoint": line.checkpoint,
            "trainings": line.trainings,
            "samples": row["samples"],
            "seeds": row["seeds"],
            **{name: row[name] if one else None for name in ("scenes", "agents", "blocks")},
        }
        for name in _names(lines):
            value = line.values.get(name, Value())
            low, high = value.interval or (None, None)
            cells |= {name: value.mean, f"{name}_low": low, f"{name}_high": high}
            cells[f"{name}_std"] = value.spread
        rows.append(cells)
    return pl.DataFrame(rows, infer_schema_length=None).write_csv()


def _paper_markdown(lines: Sequence[Line]) -> str:
    """Means with 95 % intervals; the significantly best is bold."""
    metrics = _metrics(lines)
    rows = [
        [
            line.test_set.dataset,
            label,
            k,
            *(_marked(*each, line, "**{}**") for each in metrics.items()),
        ]
        for line, label, k in _labelled(lines)
    ]
    return markdown_table(
        ["", "", "k", *map(_head, metrics.values())], rows, right=len(metrics) + 1
    )


def _latex_table(lines: Sequence[Line]) -> str:
    """A `tabular` of booktabs: means with 95 % intervals, the significantly best bold."""
    metrics = _metrics(lines)
    head = ["", "", "$k$", *(_escaped(_head(metric)) for metric in metrics.values())]
    body, before = [], None
    for line, label, k in _labelled(lines):
        cells = [_marked(*each, line, r"\textbf{{{}}}", latex=True) for each in metrics.items()]
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
    """Explanations below a table, for a `paper` or a terminal; and of `bold` numbers."""
    interval = "[ ]: 95 % interval" if paper else "±: half of a 95 % interval"
    found = [metric.about for metric in _metrics(lines).values() if metric.about]
    blocks = [line.rows[0]["blocks"] for line in lines if line.trainings == 1]
    if counts := sorted(set(blocks)):
        number = f"{counts[0]}" if len(counts) == 1 else f"{counts[0]} to {counts[-1]}"
        found.append(f"{interval} by bootstrap over {number} blocks of scenes")
    if several := sorted({line.trainings for line in lines if line.trainings > 1}):
        found.append(
            f"{', '.join(map(str, several))} trainings: Student's interval of their mean instead"
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
            f"means over {seeds} noise seeds, between which the standard deviation is at most "
            f"{max(spreads):.3f} m"
        )
    if bold and any(value.best for line in lines for value in line.values.values()):
        found.append("bold: significantly better than all others (95 % intervals do not overlap)")
    return list(dict.fromkeys(found))


def labels(lines: Sequence[Line]) -> list[str]:
    """Names of the models of one test set; of equal names, with the checkpoint."""
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


def _metrics(lines: Sequence[Line]) -> dict[str, Metric]:
    return {name: known_metric(name) for name in _names(lines)}


def _names(lines: Sequence[Line]) -> list[str]:
    """Names of the metrics of which some line has a value."""
    values = [item for line in lines for item in line.values.items()]
    return list(dict.fromkeys(name for name, value in values if value.mean is not None))


def _head(metric: Metric) -> str:
    """Head of a paper's column; per cents stand in its cells."""
    return metric.title if metric.unit == "share" else metric.label


def _with_half(metric: Metric, value: Value | None) -> "Text":
    from rich.text import Text

    value = value or Value()
    text = metric.text(value.mean)
    if value.interval is not None and metric.unit in ("", "m"):
        low, high = value.interval
        text += f" ±{(high - low) / 2:.3f}".replace("±0.", "±.")
    return Text(text, style="bold" if value.best else "")


def _marked(name: str, metric: Metric, line: Line, bold: str, *, latex: bool = False) -> str:
    value = line.values.get(name, Value())
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
