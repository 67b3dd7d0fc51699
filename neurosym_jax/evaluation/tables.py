"""An evaluation's rows as tables: for a terminal, and as CSV, Markdown and LaTeX for a paper."""

import dataclasses
import shutil
from collections.abc import Callable, Iterator, Sequence
from typing import Literal

import polars as pl

from neurosym_jax.evaluation.markdown import markdown_table
from neurosym_jax.evaluation.metrics import Metric, known_metric
from neurosym_jax.evaluation.summary import Line, Value, labels, lines_of, means_of
from neurosym_jax.evaluation.test_sets import TestSet

__all__ = ["Style", "format_table", "line_labels", "notes", "text_tables"]

Style = Literal["text", "csv", "markdown", "latex"]

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
    if style == "text":
        return "\n".join([text_tables(lines, width), *notes(lines)])
    return {"csv": _csv_table, "markdown": _markdown_table, "latex": _latex_table}[style](lines)


def text_tables(lines: Sequence[Line], width: int | None = None, *, whole: bool = True) -> str:
    """A table for each test set, for a terminal; after ± stands half of the 95 % interval.

    Args:
        lines: of any test sets.
        width: columns of the terminal; default: the terminal's.
        whole: whether columns that do not fit are in further tables, or left out.
    """
    width = width or shutil.get_terminal_size().columns
    texts = []
    for test_set, members in _by_test_set(lines):
        row, one = members[0].rows[0], members[0].datasets == 1
        counts = f", {row['scenes']} scenes, {row['agents']} people" if one else ""
        title = f"{test_set.dataset}: {test_set.obs_len} + {test_set.pred_len} steps{counts}"
        models, *rest = _columns(members)
        for further in range(len(rest)):
            if not rest or (further and not whole):
                break
            taken, left = [models], width - len(models[0])
            for column in list(rest):
                # At least one column, however narrow the terminal is.
                if len(column[0]) + 2 <= left or len(taken) == 1:
                    taken.append(column)
                    rest.remove(column)
                    left -= len(column[0]) + 2
            table = ["  ".join(cells).rstrip() for cells in zip(*taken)]
            texts.append("\n".join([*([] if further else [title]), *table, ""]))
    return "\n".join(texts)


def _columns(lines: Sequence[Line]) -> list[list[str]]:
    """Cells of equal width of each column, two rows of head first."""
    columns = [["", "model", *line_labels(lines)]]
    for name, metric in _metrics(lines).items():
        values = [line.values.get(name, Value()) for line in lines]
        marked = any(value.best for value in values)
        cells = [_with_half(metric, each) + " *"[each.best] * marked for each in values]
        columns.append([*_head_rows(metric.title), *cells])
    slowest = [max(1000 * row["latency"] for row in line.rows) for line in lines]
    rates = [min(row["forecasts_per_second"] for row in line.rows) for line in lines]
    columns.append(["", "k", *(str(line.rows[0]["samples"]) for line in lines)])
    columns.append(["forecasts", "a second", *(f"{rate:.0f}" for rate in rates)])
    columns.append(["latency", "in ms", *(f"{milliseconds:.1f}" for milliseconds in slowest)])
    widths = [max(map(len, column)) for column in columns]
    justify: list[Callable[[str, int], str]] = [str.ljust, *[str.rjust] * (len(columns) - 1)]
    return [
        [side(cell, width) for cell in column]
        for side, column, width in zip(justify, columns, widths)
    ]


def _head_rows(title: str) -> tuple[str, str]:
    first, _, rest = title.partition(" ")
    return (first, rest) if rest else ("", first)


def _with_half(metric: Metric, value: Value) -> str:
    text = metric.text(value.mean)
    if value.interval is not None and metric.unit in ("", "m"):
        low, high = value.interval
        text += f" ±{(high - low) / 2:.3f}".replace("±0.", "±.")
    return text


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
        for name in _metrics(lines):
            value = line.values.get(name, Value())
            low, high = value.interval or (None, None)
            cells |= {name: value.mean, f"{name}_low": low, f"{name}_high": high}
            cells[f"{name}_std"] = value.spread
        rows.append(cells)
    return pl.DataFrame(rows, infer_schema_length=None).write_csv()


def _markdown_table(lines: Sequence[Line]) -> str:
    """Means with 95 % intervals; the significantly best is bold."""
    metrics = _metrics(lines)
    rows = [
        [test_set.dataset, label, str(line.rows[0]["samples"]), *_cells(metrics, line, "**{}**")]
        for test_set, members in _by_test_set(lines)
        for line, label in zip(members, line_labels(members))
    ]
    head = ["", "", "k", *map(_head, metrics.values())]
    return markdown_table(head, rows, right=len(metrics) + 1)


def _latex_table(lines: Sequence[Line]) -> str:
    """A `tabular` of booktabs: means with 95 % intervals, the significantly best bold."""
    metrics = _metrics(lines)
    body: list[str] = []
    for test_set, members in _by_test_set(lines):
        name = f"{test_set.dataset}, {test_set.obs_len} + {test_set.pred_len}"
        body += [r"\midrule"]
        for line, label in zip(members, line_labels(members)):
            cells = [_escaped(name), _escaped(label), str(line.rows[0]["samples"])]
            cells += _cells(metrics, line, r"\textbf{{{}}}", latex=True)
            body.append(" & ".join(cells) + r" \\")
            name = ""
    head = ["", "", "$k$", *(_escaped(_head(metric)) for metric in metrics.values())]
    return "\n".join(
        [
            r"% \usepackage{booktabs}",
            *(f"% {note}" for note in notes(lines, paper=True)),
            rf"\begin{{tabular}}{{ll{'r' * (len(metrics) + 1)}}}",
            r"\toprule",
            " & ".join(head) + r" \\",
            *body,
            r"\bottomrule",
            r"\end{tabular}",
        ]
    )


def notes(lines: Sequence[Line], *, paper: bool = False) -> list[str]:
    """Explanations below a table, for a `paper` or a terminal."""
    found = [metric.about for metric in _metrics(lines).values() if metric.about]
    interval = "[ ]: 95 % interval" if paper else "±: half of a 95 % interval"
    single = [line for line in lines if line.trainings == 1]
    if counts := sorted({line.rows[0]["blocks"] for line in single}):
        number = f"{counts[0]}" if len(counts) == 1 else f"{counts[0]} to {counts[-1]}"
        found.append(f"{interval} by bootstrap over {number} blocks of scenes")
    if several := sorted({line.trainings for line in lines} - {1}):
        number = ", ".join(map(str, several))
        found.append(f"{number} trainings: Student's interval of their mean instead")
    spreads = [
        value.spread
        for line in single
        for name, value in line.values.items()
        if value.spread is not None and known_metric(name).unit == "m"
    ]
    if spreads:
        found.append(
            f"means over {lines[0].rows[0]['seeds']} noise seeds, between which the standard "
            f"deviation is at most {max(spreads):.3f} m"
        )
    if any(value.best for line in lines for value in line.values.values()):
        mark = "bold" if paper else "*"
        found.append(f"{mark}: significantly better than all others (95 % intervals are apart)")
    return list(dict.fromkeys(found))


def line_labels(lines: Sequence[Line]) -> list[str]:
    """Names of the models of one test set; of equal names, with the checkpoint."""
    names = labels([(line.model, line.checkpoint) for line in lines])
    counts = [f" ({n} trainings)" if n > 1 else "" for n in (line.trainings for line in lines)]
    return [name + count for name, count in zip(names, counts)]


def _by_test_set(lines: Sequence[Line]) -> Iterator[tuple[TestSet, list[Line]]]:
    for test_set in dict.fromkeys(line.test_set for line in lines):
        yield test_set, [line for line in lines if line.test_set == test_set]


def _metrics(lines: Sequence[Line]) -> dict[str, Metric]:
    """The metrics of which some line has a value."""
    values = [item for line in lines for item in line.values.items()]
    names = dict.fromkeys(name for name, value in values if value.mean is not None)
    return {name: known_metric(name) for name in names}


def _head(metric: Metric) -> str:
    """Head of a paper's column; per cents stand in its cells."""
    return metric.title if metric.unit == "share" else metric.label


def _cells(
    metrics: dict[str, Metric], line: Line, bold: str, *, latex: bool = False
) -> Iterator[str]:
    for name, metric in metrics.items():
        value = line.values.get(name, Value())
        text = metric.text(value.mean)
        text = _escaped(text) if latex else text
        text = bold.format(text) if value.best else text
        if value.interval is not None:
            low, high = (metric.text(bound).split(" ")[0] for bound in value.interval)
            text += f" {{\\footnotesize [{low}, {high}]}}" if latex else f" [{low}, {high}]"
        yield text


def _escaped(text: str) -> str:
    return "".join(LATEX.get(letter, letter) for letter in text)
