"""An evaluation's rows as tables: for a terminal, and as CSV, Markdown and LaTeX for a paper."""

import itertools
import shutil
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any, Literal, NamedTuple

import polars as pl

from neurosym_jax.evaluation.markdown import aligned_table, markdown_table
from neurosym_jax.evaluation.metrics import Metric, known_metric
from neurosym_jax.evaluation.summary import labels, short_names, summarise

__all__ = ["Style", "format_table", "notes", "text_tables"]

Style = Literal["text", "csv", "markdown", "latex"]

LATEX = {**{sign: f"\\{sign}" for sign in "&%$#_{}"}, "\\": r"\textbackslash{}"}
LATEX |= {"~": r"\textasciitilde{}", "^": r"\textasciicircum{}", "±": r"$\pm$"}


class Line(NamedTuple):
    """A model on a test set."""

    label: str
    facts: Mapping[str, Any]
    """The columns of `summarise` that all metrics share."""
    values: Mapping[str, Mapping[str, Any]]
    """The rows of `summarise` by metric."""


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
    lines = summarise(rows)
    if style == "text":
        shown = lines if whole else lines.filter(pl.col("sets") == 1)
        return "\n".join([text_tables(shown, width, whole=whole), *notes(lines)])
    if style == "latex":
        return _latex_table(lines, intervals)
    return _csv_table(lines) if style == "csv" else _markdown_table(lines)


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
        of = members[0].facts
        counts = f", {of['scenes']} scenes, {of['agents']} people" * (of["sets"] == 1)
        title = [f"{of['dataset']}: {of['obs_len']} + {of['pred_len']} steps{counts}"]
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
    columns = []
    for name, metric in _metrics(members).items():
        cells = [_text_cell(metric, line.values.get(name)) for line in members]
        if any(cell.endswith("*") for cell in cells):
            cells = [cell if cell.endswith("*") else f"{cell} " for cell in cells]
        first, _, rest = metric.title.partition(" ")
        columns.append([first, rest, *cells] if rest else ["", first, *cells])
    heads = (("", "k"), ("forecasts", "a second"), ("latency", "in ms"))
    facts = [
        (of["samples"], f"{of['forecasts_per_second']:.0f}", f"{1000 * of['latency']:.1f}")
        for of in (line.facts for line in members)
    ]
    columns += [[*head, *map(str, cells)] for head, cells in zip(heads, zip(*facts))]
    right = [[cell.rjust(max(map(len, column))) for cell in column] for column in columns]
    models = ["", "model", *(line.label for line in members)]
    return [[cell.ljust(max(map(len, models))) for cell in models], *right]


def _csv_table(lines: pl.DataFrame) -> str:
    """A line each, with unrounded numbers; `_low` and `_high` bound the 95 % interval."""
    facts = ["dataset", "obs_len", "pred_len", "model", "checkpoint", "trainings", "samples"]
    facts += ["seeds", "scenes", "agents", "blocks"]
    values = {"mean": "", "low": "_low", "high": "_high", "std": "_std"}
    wide = lines.pivot("metric", index=["line", *facts], values=list(values), maintain_order=True)
    columns = [
        pl.col(f"{value}_{metric}").alias(f"{metric}{ending}")
        for metric in lines["metric"].unique(maintain_order=True)
        for value, ending in values.items()
    ]
    return wide.select(*facts, *columns).write_csv()


def _markdown_table(lines: pl.DataFrame) -> str:
    """Means with 95 % intervals; the significantly best is bold."""
    members = list(itertools.chain.from_iterable(_by_test_set(lines)))
    metrics = _metrics(members)
    heads = [each.title if each.unit == "share" else each.label for each in metrics.values()]
    body = []
    for line in members:
        cells = [_cell(metric, line.values.get(name)) for name, metric in metrics.items()]
        texts = [(f"**{text}**" if best else text) + interval for text, interval, best in cells]
        body.append([line.facts["dataset"], line.label, str(line.facts["samples"]), *texts])
    return markdown_table(["", "", "k", *heads], body, right=len(heads) + 1)


def _latex_table(lines: pl.DataFrame, intervals: bool) -> str:
    """A `tabular` of booktabs for one column of a paper: the significantly best mean is bold."""
    tests = list(_by_test_set(lines))
    members = list(itertools.chain.from_iterable(tests))
    metrics = _metrics(members)
    titles = [metric.title.partition(" ") for metric in metrics.values()]
    above, below = ["", ""], ["", "$k$"]
    for first, parts in itertools.groupby(titles, lambda title: title[0] if title[2] else ""):
        rests = [rest or word for word, _, rest in parts]
        above.append(rf"\multicolumn{{{len(rests)}}}{{c}}{{{_escaped(first)}}}")
        below += map(_escaped, rests)
    short = short_names(line.label for line in members)
    rows = []
    for of_test in tests:
        of = of_test[0].facts
        title = _escaped(f"{of['dataset']}, {of['obs_len']} + {of['pred_len']} steps")
        rows += [r"\midrule", rf"\multicolumn{{{len(below)}}}{{l}}{{\emph{{{title}}}}} \\"]
        for line in of_test:
            cells = [_escaped(short[line.label]), str(line.facts["samples"])]
            for name, metric in metrics.items():
                text, interval, best = _cell(metric, line.values.get(name))
                text = rf"\textbf{{{_escaped(text)}}}" if best else _escaped(text)
                cells.append(text + rf"{{\scriptsize{interval}}}" * (intervals and bool(interval)))
            rows.append(" & ".join(cells) + r" \\")
    named = [f"{brief}: {name}" for name, brief in short.items() if brief != name]
    units = ["errors in metres"] * any(metric.unit == "m" for metric in metrics.values())
    return "\n".join(
        [
            r"% \usepackage{booktabs}",
            *(f"% {note}" for note in [*named, *units, *notes(lines, intervals=intervals)]),
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


def _text_cell(metric: Metric, value: Mapping[str, Any] | None) -> str:
    text, interval, best = _cell(metric, value)
    if value is not None and interval and metric.unit in ("", "m"):
        text += f" ±{(value['high'] - value['low']) / 2:.3f}".replace("±0.", "±.")
    return text + "*" * best


def _cell(metric: Metric, value: Mapping[str, Any] | None) -> tuple[str, str, bool]:
    """A mean, its interval where that is known, and whether it is significantly the best."""
    if value is None or value["mean"] is None:
        return "-", "", False
    text = metric.text(value["mean"])
    if value["low"] is None:
        return text, "", value["best"]
    low, high = (metric.text(value[end]).split(" ")[0] for end in ("low", "high"))
    return text, f" [{low}, {high}]", value["best"]


def notes(lines: pl.DataFrame, *, intervals: bool | None = None) -> list[str]:
    """Explanations below a table for a terminal or, given whether it has `intervals`, a paper."""
    known = lines.filter(pl.col("mean").is_not_null())["metric"].unique(maintain_order=True)
    found = [known_metric(name).about for name in known]
    single = lines.filter(pl.col("trainings") == 1)["blocks"].drop_nulls().unique().sort().to_list()
    if single and intervals is not False:
        interval = "[ ]: 95 % interval" if intervals else "±: half of a 95 % interval"
        number = f"{single[0]}" if len(single) == 1 else f"{single[0]} to {single[-1]}"
        found.append(f"{interval} by bootstrap over {number} blocks of scenes")
    if several := lines.filter(pl.col("trainings") > 1)["trainings"].unique().sort().to_list():
        number = ", ".join(map(str, several))
        found.append(f"{number} trainings: Student's interval of their mean instead")
    if lines["best"].any():
        mark = "*" if intervals is None else "bold"
        found.append(f"{mark}: significantly better than all others (95 % intervals are apart)")
    return [note for note in dict.fromkeys(found) if note]


def _by_test_set(lines: pl.DataFrame) -> Iterator[list[Line]]:
    """The lines of each test set."""
    for _, of in lines.group_by("dataset", "obs_len", "pred_len", maintain_order=True):
        values = [
            {value["metric"]: value for value in line.iter_rows(named=True)}
            for _, line in of.group_by("line", maintain_order=True)
        ]
        facts = [next(iter(each.values())) for each in values]
        names = labels([(each["model"], each["checkpoint"]) for each in facts])
        counts = [f" ({of['trainings']} trainings)" * (of["trainings"] > 1) for of in facts]
        yield [Line(name + count, *of) for name, count, *of in zip(names, counts, facts, values)]


def _metrics(lines: Iterable[Line]) -> dict[str, Metric]:
    """The metrics of which some line has a value."""
    values = [value for line in lines for value in line.values.values()]
    names = dict.fromkeys(value["metric"] for value in values if value["mean"] is not None)
    return {name: known_metric(name) for name in names}


def _escaped(text: str) -> str:
    return "".join(LATEX.get(letter, letter) for letter in text)
