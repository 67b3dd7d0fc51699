"""An evaluation's rows as tables: for a terminal, and as CSV, Markdown and LaTeX for a paper."""

import shutil
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Literal

import polars as pl

from neurosym_jax.evaluation.markdown import aligned_table, markdown_table
from neurosym_jax.evaluation.metrics import Metric, known_metric
from neurosym_jax.evaluation.summary import labels, summarise

__all__ = ["Style", "format_table", "notes", "text_tables"]

Style = Literal["text", "csv", "markdown", "latex"]
Line = dict[str, dict[str, Any]]
"""The rows of one line of `summarise`, by metric."""

LATEX = {**{sign: f"\\{sign}" for sign in "&%$#_{}"}, "\\": r"\textbackslash{}"}
LATEX |= {"~": r"\textasciitilde{}", "^": r"\textasciicircum{}", "±": r"$\pm$"}


def format_table(rows: pl.DataFrame, style: Style = "text", width: int | None = None) -> str:
    """Rows as tables: one for each test set and horizon and, of several, one of their means.

    Args:
        rows: see `evaluate`; runs whose checkpoints differ in `seed0`, `seed1`, ... are one line.
        style: text for a terminal; csv, markdown or latex for a paper.
        width: columns of a terminal; default: the terminal's.
    """
    lines = summarise(rows)
    if style == "text":
        return "\n".join([text_tables(lines, width), *notes(lines)])
    return {"csv": _csv_table, "markdown": _markdown_table, "latex": _latex_table}[style](lines)


def text_tables(lines: pl.DataFrame, width: int | None = None, *, whole: bool = True) -> str:
    """A table for each test set, for a terminal; after ± stands half of the 95 % interval.

    Args:
        lines: see `summarise`.
        width: columns of the terminal; default: the terminal's.
        whole: whether columns that do not fit are in further tables, or left out.
    """
    width = width or shutil.get_terminal_size().columns
    texts = []
    for members in _by_test_set(lines):
        first = _facts(members[0])
        counts = f", {first['scenes']} scenes, {first['agents']} people" * (first["sets"] == 1)
        title = [f"{first['dataset']}: {first['obs_len']} + {first['pred_len']} steps{counts}"]
        models, *rest = _columns(members)
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


def _columns(members: Sequence[Line]) -> list[list[str]]:
    """Cells of equal width of each column, two rows of head first."""
    models = ["", "model", *_labels(members)]
    columns = []
    for name, metric in _metrics(members).items():
        cells = [_cell(metric, line.get(name), "text") for line in members]
        if any(cell.endswith("*") for cell in cells):
            cells = [cell if cell.endswith("*") else f"{cell} " for cell in cells]
        first, _, rest = metric.title.partition(" ")
        columns.append([first, rest, *cells] if rest else ["", first, *cells])
    facts = [_facts(line) for line in members]
    columns.append(["", "k", *(str(of["samples"]) for of in facts)])
    rates = (f"{of['forecasts_per_second']:.0f}" for of in facts)
    columns.append(["forecasts", "a second", *rates])
    columns.append(["latency", "in ms", *(f"{1000 * of['latency']:.1f}" for of in facts)])
    widths = [max(map(len, column)) for column in columns]
    longest = max(map(len, models))
    return [
        [cell.ljust(longest) for cell in models],
        *([cell.rjust(width) for cell in column] for column, width in zip(columns, widths)),
    ]


def _csv_table(lines: pl.DataFrame) -> str:
    """A line each, with unrounded numbers; `_low` and `_high` bound the 95 % interval."""
    facts = ("dataset", "obs_len", "pred_len", "model", "checkpoint", "trainings", "samples")
    facts += ("seeds", "scenes", "agents", "blocks")
    rows = []
    for _, of in lines.group_by("line", maintain_order=True):
        row: dict[str, Any] = dict(zip(facts, of.select(facts).row(0)))
        for value in of.iter_rows(named=True):
            name = value["metric"]
            row |= {name: value["mean"], f"{name}_low": value["low"]}
            row |= {f"{name}_high": value["high"], f"{name}_std": value["std"]}
        rows.append(row)
    return pl.DataFrame(rows, infer_schema_length=None).write_csv()


def _markdown_table(lines: pl.DataFrame) -> str:
    """Means with 95 % intervals; the significantly best is bold."""
    heads, body = _body(lines, "markdown")
    return markdown_table(["", "", "k", *heads], body, right=len(heads) + 1)


def _latex_table(lines: pl.DataFrame) -> str:
    """A `tabular` of booktabs: means with 95 % intervals, the significantly best bold."""
    heads, body = _body(lines, "latex")
    rows, before = [], ""
    for name, *cells in body:
        rows += [r"\midrule"] * (name != before)
        rows.append(" & ".join([name if name != before else "", *cells]) + r" \\")
        before = name
    return "\n".join(
        [
            r"% \usepackage{booktabs}",
            *(f"% {note}" for note in notes(lines, paper=True)),
            rf"\begin{{tabular}}{{ll{'r' * (len(heads) + 1)}}}",
            r"\toprule",
            " & ".join(["", "", "$k$", *map(_escaped, heads)]) + r" \\",
            *rows,
            r"\bottomrule",
            r"\end{tabular}",
        ]
    )


def _body(lines: pl.DataFrame, style: Style) -> tuple[list[str], list[list[str]]]:
    """Heads of the metrics' columns, and of each line the test set, the model, k and cells."""
    tests = list(_by_test_set(lines))
    metrics = _metrics([line for members in tests for line in members])
    heads = [each.title if each.unit == "share" else each.label for each in metrics.values()]
    body = []
    for members in tests:
        for line, label in zip(members, _labels(members)):
            of = _facts(line)
            test = of["dataset"]
            if style == "latex":
                test, label = (
                    _escaped(f"{test}, {of['obs_len']} + {of['pred_len']}"),
                    _escaped(label),
                )
            cells = (_cell(metric, line.get(name), style) for name, metric in metrics.items())
            body.append([test, label, str(of["samples"]), *cells])
    return heads, body


def _cell(metric: Metric, value: Mapping[str, Any] | None, style: Style) -> str:
    """A mean with its interval; the significantly best is marked."""
    if value is None or value["mean"] is None:
        return "-"
    text, known = metric.text(value["mean"]), value["low"] is not None
    if style == "text":
        if known and metric.unit in ("", "m"):
            text += f" ±{(value['high'] - value['low']) / 2:.3f}".replace("±0.", "±.")
        return text + "*" * value["best"]
    low, high = (metric.text(value[end]).split(" ")[0] for end in ("low", "high"))
    if style == "latex":
        text = rf"\textbf{{{_escaped(text)}}}" if value["best"] else _escaped(text)
        return text + rf" {{\footnotesize [{low}, {high}]}}" * known
    text = f"**{text}**" if value["best"] else text
    return text + f" [{low}, {high}]" * known


def notes(lines: pl.DataFrame, *, paper: bool = False) -> list[str]:
    """Explanations below a table, for a `paper` or a terminal."""
    known = lines.filter(pl.col("mean").is_not_null())["metric"].unique(maintain_order=True)
    found = [known_metric(name).about for name in known]
    interval = "[ ]: 95 % interval" if paper else "±: half of a 95 % interval"
    single = lines.filter(pl.col("trainings") == 1)["blocks"].drop_nulls().unique().sort().to_list()
    if single:
        number = f"{single[0]}" if len(single) == 1 else f"{single[0]} to {single[-1]}"
        found.append(f"{interval} by bootstrap over {number} blocks of scenes")
    if several := lines.filter(pl.col("trainings") > 1)["trainings"].unique().sort().to_list():
        number = ", ".join(map(str, several))
        found.append(f"{number} trainings: Student's interval of their mean instead")
    if lines["best"].any():
        mark = "bold" if paper else "*"
        found.append(f"{mark}: significantly better than all others (95 % intervals are apart)")
    return [note for note in dict.fromkeys(found) if note]


def _by_test_set(lines: pl.DataFrame) -> Iterator[list[Line]]:
    """The lines of each test set."""
    for _, of in lines.group_by("dataset", "obs_len", "pred_len", maintain_order=True):
        yield [
            {value["metric"]: value for value in line.iter_rows(named=True)}
            for _, line in of.group_by("line", maintain_order=True)
        ]


def _facts(line: Line) -> dict[str, Any]:
    return next(iter(line.values()))


def _labels(members: Sequence[Line]) -> list[str]:
    """Names of the models of one test set, with the number of their trainings."""
    facts = [_facts(line) for line in members]
    names = labels([(of["model"], of["checkpoint"]) for of in facts])
    counts = [f" ({of['trainings']} trainings)" * (of["trainings"] > 1) for of in facts]
    return [name + count for name, count in zip(names, counts)]


def _metrics(members: Sequence[Line]) -> dict[str, Metric]:
    """The metrics of which some line has a value."""
    values = [value for line in members for value in line.values()]
    names = dict.fromkeys(value["metric"] for value in values if value["mean"] is not None)
    return {name: known_metric(name) for name in names}


def _escaped(text: str) -> str:
    return "".join(LATEX.get(letter, letter) for letter in text)
