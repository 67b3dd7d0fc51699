"""Results as rows of a dataframe and as tables in text, CSV, Markdown and LaTeX."""

import itertools
import re
import shutil
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import PurePath
from typing import Any, Literal, NamedTuple

import numpy as np
import polars as pl

from neurosym_jax.errors import printable
from neurosym_jax.evaluation.intervals import (
    FEWEST,
    against_best,
    student_half,
    student_p,
)
from neurosym_jax.evaluation.metrics import Metric, known_metric

__all__ = [
    "Row",
    "Style",
    "aligned_table",
    "csv_text",
    "first_trainings",
    "format_table",
    "labels",
    "latex_text",
    "markdown_table",
    "markdown_text",
    "rows_frame",
    "short_names",
    "summarise",
    "unique_suffixes",
]


# Tables as text, in Markdown and in aligned columns for a terminal; and foreign names
# in them.

LATEX = {
    **{sign: f"\\{sign}" for sign in "&%$#_{}"},
    "\\": r"\textbackslash{}",
    "~": r"\textasciitilde{}",
    "^": r"\textasciicircum{}",
    "±": r"$\pm$",
}
MARKDOWN = {
    **{sign: f"\\{sign}" for sign in "\\`*[]"},
    "<": "&lt;",
    ">": "&gt;",
    "&": "&amp;",
}


def latex_text(text: str) -> str:
    """Foreign text that LaTeX prints as it is."""
    return "".join(LATEX.get(letter, letter) for letter in printable(text))


def markdown_text(text: str) -> str:
    """Foreign text that Markdown shows as it is; `markdown_table` escapes a `|`."""
    return "".join(MARKDOWN.get(letter, letter) for letter in printable(text))


def markdown_table(
    head: Sequence[str], rows: Iterable[Sequence[str]], *, right: int = 0
) -> str:
    """Lines of a table; `right` of its last columns are aligned to the right.

    A `|` or a line's end in a cell stays within the cell.
    """
    rule = ["---"] * (len(head) - right) + ["---:"] * right
    lines = [_line(head), f"|{'|'.join(rule)}|", *map(_line, rows)]
    return "\n".join(lines)


def csv_text(frame: pl.DataFrame) -> str:
    """A table as CSV, in which no foreign text is a formula.

    Spreadsheets calculate a cell that begins with `=`, `+`, `@`, or `-` and a letter;
    with a `'` in front they show it. Numbers stay as they are.
    """
    formula = r"^([=+@]|-\p{L})"
    quoted = pl.col(pl.String).str.replace(formula, "'$1")
    return frame.with_columns(quoted).write_csv()


def aligned_table(rows: Sequence[Sequence[str]]) -> str:
    """Rows of cells, the head among them, as lines whose columns stand below each other.

    Characters that steer a terminal are escaped.
    """
    rows = [list(map(printable, row)) for row in rows]
    widths = [max(map(len, column)) for column in zip(*rows)]
    lines = []
    for row in rows:
        cells = map(str.ljust, row, widths)
        lines.append("  ".join(cells).rstrip())
    return "\n".join(lines)


def _line(cells: Sequence[str]) -> str:
    texts = []
    for cell in cells:
        text = " ".join(cell.split()).replace("|", r"\|")
        texts.append(f" {text} " if text else " ")
    return f"|{'|'.join(texts)}|"


# Lines of tables: a model on a test set, by one training or several; and means over
# test sets.
#
# The 95 % interval of a line is
#
# - of one training: over the scenes of the test set, in blocks (see `intervals`);
# - of several that differ in their seed: Student's t of the trainings' mean;
# - of a mean over test sets: Student's t of the means of each seed where there are
#   several trainings, else of independent test sets.
#
# A line is the best of its test set where the paired test against each other line,
# adjusted for their number, is significant at 5 %; for means over test sets the test is
# Student's of the sets' means. A model that was trained on the people of the test set, or
# that sees who was there before (online), is compared with none, and its line says so.

Row = dict[str, Any]
"""Plain numbers and texts of a model on a test set, by column.

A metric has its mean under its name, the bounds of the 95 % interval under `NAME_low` and
`NAME_high` (None for too few blocks), and under `NAME_std` the standard deviation between seeds of
the noise. `compare.with_tests` adds `NAME_p`. None where there is none."""
IDENTITY = ("model", "configuration", "training_data")
"""Columns that are the same for all trainings of a model, see `Model.configuration`."""
HORIZON = ("obs_len", "pred_len")
FACTS = ("dataset", *HORIZON, "model", "samples", "seeds", "scenes", "agents", "blocks")
"""Columns of a row that a line keeps."""
ENDS = {"mean": "", "low": "_low", "high": "_high", "std": "_std", "p": "_p"}
"""How the columns of a metric end in a row, by what a line calls them."""


def rows_frame(rows: Sequence[Row]) -> pl.DataFrame:
    """The rows of an evaluation as a data frame."""
    return pl.DataFrame(rows, infer_schema_length=None)


def summarise(rows: pl.DataFrame) -> pl.DataFrame:
    """The values of all lines, those of means over test sets last.

    Args:
        rows: see `evaluate`.

    Returns:
        A row for each line and metric, with `line` (a number), the columns of `FACTS`,
        `checkpoint` (of several trainings with `*` for what differs), `trainings`, `sets`
        (number of test sets), `metric`, its `mean` (None where nothing was counted),
        the bounds `low` and `high` of its 95 % interval, `std` (between trainings or,
        of one, between seeds of the noise), `p` (of the test against the best,
        adjusted; None for the best itself), `learned`, whether the model was trained
        on these people, `online`, whether it saw who was there before, and `best`,
        whether `p` of all other lines of the test set is below 5 %.
    """
    lines = _lines(rows)
    tested = _tested(list(_means(lines)))
    means = pl.DataFrame(tested, schema=lines.schema)
    lines = pl.concat([lines, means]).drop("means", "trained")
    group = ("dataset", *HORIZON, "metric")
    p = pl.col("p")
    is_compared = ~(pl.col("learned") | pl.col("online"))
    first = pl.col("mean").is_not_null() & p.is_null() & is_compared
    is_alone = first.sum().over(group) == 1
    are_worse = p.max().over(group) < 0.05
    best = first & is_alone & are_worse
    return lines.with_columns(best=best.fill_null(False))


def labels(models: Sequence[tuple[str, str | None]]) -> list[str]:
    """Names of models on one test set, given (name, checkpoint); of equal ones, with the shortest
    unique end of the checkpoint."""
    paths = list(dict.fromkeys(path for _, path in models if path))
    suffixes = unique_suffixes(list(map(PurePath, paths)))
    short = dict(zip(paths, suffixes))
    names = [name for name, _ in models]
    texts = []
    for name, path in models:
        if path and names.count(name) > 1:
            name = f"{name} {short[path]}"
        texts.append(name)
    return texts


def unique_suffixes(paths: Sequence[PurePath]) -> list[str]:
    """The shortest ends of all paths that tell them apart, without the parts that all end with."""
    parts = [path.parts for path in dict.fromkeys(paths)]
    while len(parts) > 1 and _end_alike(parts):
        parts = [path[:-1] for path in parts]
    longest = max(map(len, parts), default=0)
    unique = [str(path) for path in paths]
    for size in range(1, longest + 1):
        ends = ["/".join(path[-size:]) for path in parts]
        if len(set(ends)) == len(parts):
            unique = ends
            break
    suffixes = dict(zip(dict.fromkeys(paths), unique))
    return [suffixes[path] for path in paths]


def _end_alike(parts: Sequence[tuple[str, ...]]) -> bool:
    """Whether paths have one last part, and others before it."""
    ends = {path[-1:] for path in parts}
    return len(ends) == 1 and min(map(len, parts)) > 1


def short_names(names: Iterable[str]) -> dict[str, str]:
    """Labels by name for narrow tables: CV for constant velocity, and without options.

    Names that would be the same stay as they are.
    """
    short = {}
    for name in names:
        label = name.replace("constant velocity", "CV")
        short[name] = re.sub(r",\S+", "", label)
    counts = Counter(short.values())
    for name, label in short.items():
        if counts[label] > 1:
            short[name] = name
    return short


def first_trainings(rows: Sequence[Mapping[str, Any]]) -> list[int]:
    """The index of the first training of each row's model, on the same test set.

    Trainings of one model share all columns of `IDENTITY` and differ in their seed. A
    row is a model of its own where one of these is not known, or where two rows of one
    seed differ in something that no column says.
    """
    trainings: dict[Any, list[int]] = {}
    for number, row in enumerate(rows):
        identity = [row.get(column) for column in IDENTITY]
        if None not in (*identity, row.get("training_seed")):
            test_set = [row.get(column) for column in ("dataset", *HORIZON)]
            numbers = trainings.setdefault((*test_set, *identity), [])
            numbers.append(number)
    first = list(range(len(rows)))
    for numbers in trainings.values():
        seeds = {rows[number]["training_seed"] for number in numbers}
        if len(seeds) == len(numbers):
            for number in numbers:
                first[number] = numbers[0]
    return first


def _lines(rows: pl.DataFrame) -> pl.DataFrame:
    """Lines of one test set; `means` and `trained` are means and seeds of the trainings."""
    rows = rows.with_columns(
        _optional(rows, "training_seed", pl.Int64),
        _optional(rows, "configuration", pl.String),
        _optional(rows, "learned", pl.Boolean).fill_null(False),
        _optional(rows, "online", pl.Boolean).fill_null(False),
        line=pl.Series(first_trainings(rows.to_dicts()), dtype=pl.Int64),
    )
    metrics = [name for name in rows.columns if f"{name}_low" in rows.columns]
    tables = []
    for name in metrics:
        values = []
        for value, end in ENDS.items():
            column = _optional(rows, f"{name}{end}", pl.Float64)
            values.append(column.alias(value))
        table = rows.select(
            pl.col("training_seed", "configuration", "checkpoint", "line"),
            pl.col("learned", "online", "latency", "forecasts_per_second", *FACTS),
            *values,
            metric=pl.lit(name),
        )
        tables.append(table)
    long = pl.concat(tables)
    lines = long.group_by("line", "metric", maintain_order=True).agg(
        pl.col("configuration", *FACTS, *ENDS).first(),
        pl.col("latency").max(),
        pl.col("forecasts_per_second").min(),
        pl.col("learned", "online").any(),
        paths=pl.col("checkpoint").cast(pl.String),
        trainings=pl.len().cast(pl.Int64),
        sets=pl.lit(1),
        means=pl.col("mean"),
        trained=pl.col("training_seed"),
    )
    values = []
    for line in lines.to_dicts():
        line["checkpoint"] = _pattern(line.pop("paths"))
        if line["trainings"] > 1:
            line = _over_trainings(line)
        values.append(line)
    schema = {**lines.drop("paths").schema, "checkpoint": pl.String}
    return pl.DataFrame(values, schema=schema).sort("line", maintain_order=True)


def _optional(rows: pl.DataFrame, name: str, dtype: Any) -> pl.Expr:
    """A column; nulls for one that an older report does not have."""
    column = pl.col(name) if name in rows.columns else pl.lit(None)
    return column.cast(dtype).alias(name)


def _pattern(paths: Sequence[str | None]) -> str | None:
    """One path for several: `*` for each part that differs; None without paths."""
    parts = [PurePath(path).parts for path in paths if path is not None]
    if len(set(map(len, parts))) != 1:
        return None
    shared = []
    for first, *others in zip(*parts):
        is_shared = all(part == first for part in others)
        shared.append(first if is_shared else "*")
    return str(PurePath(*shared))


def _over_trainings(line: Row) -> Row:
    """A line of several trainings with Student's interval of their mean."""
    means = line["means"]
    if not means or None in means:
        return line | dict.fromkeys(("mean", "low", "high", "std"))
    mean = float(np.mean(means))
    half = student_half(means)
    std = float(np.std(means, ddof=1))
    bounds = {"low": mean - half, "high": mean + half}
    return line | {"mean": mean, **bounds, "std": std}


def _means(lines: pl.DataFrame) -> Iterator[Row]:
    """Means over test sets, at each horizon, of the models that were tested on all of several."""
    family = []
    for path, dataset in lines["checkpoint", "dataset"].rows():
        family.append((path or "").replace(dataset, "*"))
    lines = lines.with_columns(family=pl.Series(family))
    for _, peers in lines.group_by(HORIZON, maintain_order=True):
        names = peers["dataset"].unique(maintain_order=True).to_list()
        columns = ("model", "configuration", "family", "metric")
        for _, sets in peers.group_by(columns, maintain_order=True):
            if len(names) > 1 and sets["dataset"].to_list() == names:
                mean = _mean(sets)
                mean["line"] = len(lines) + sets["line"][0]
                mean["dataset"] = f"mean of {', '.join(names)}"
                yield mean


def _mean(sets: pl.DataFrame) -> Row:
    """The mean of one metric over test sets, a line each."""
    line = sets.row(0, named=True)
    path = line.pop("family") or None
    trainings = line["trainings"]
    means = sets["mean"].to_list()
    is_known = None not in means
    unknown = ("mean", "low", "high", "std", "p", "scenes", "agents", "blocks")
    line |= dict.fromkeys(unknown)
    line |= {"sets": len(sets), "checkpoint": path, "trainings": 1}
    line["learned"] = sets["learned"].any()
    line["online"] = sets["online"].any()
    line["latency"] = sets["latency"].max()
    line["forecasts_per_second"] = sets["forecasts_per_second"].min()
    trained = sets["trained"].to_list()
    same_seeds = all(seeds == trained[0] for seeds in trained)
    if trainings > 1 and same_seeds:
        # Trainings of one seed are not independent of each other, so they are averaged
        # first.
        averages = []
        if is_known:
            by_set = sets["means"].to_list()
            averages = np.mean(by_set, axis=0).tolist()
        line = _over_trainings(line | {"means": averages, "trainings": trainings})
        return line | {"means": means}
    line["means"] = means
    if is_known:
        mean = float(np.mean(means))
        line["mean"] = mean
        if sets["low"].null_count() == 0:
            halves = (sets["high"] - sets["low"]) / 2
            half = float(np.linalg.norm(halves)) / len(sets)
            line |= {"low": mean - half, "high": mean + half}
    return line


def _tested(means: list[Row]) -> list[Row]:
    """Lines of means over test sets, with the p values of their paired tests over the sets."""
    groups: dict[Any, list[Row]] = {}
    for line in means:
        test = [line[column] for column in ("dataset", *HORIZON, "metric")]
        groups.setdefault(tuple(test), []).append(line)
    for (*_, metric), group in groups.items():

        def p_value(best: int, other: int, group: Any = group) -> float:
            changes = np.subtract(group[best]["means"], group[other]["means"])
            return student_p(changes)

        higher = known_metric(metric).higher_is_better
        values = []
        for line in group:
            is_compared = not (line["learned"] or line["online"])
            values.append(line["mean"] if is_compared else None)
        for line, p in zip(group, against_best(values, higher, p_value)):
            line["p"] = p
    return means


# An evaluation's rows as tables: for a terminal, and as CSV, Markdown and LaTeX for a
# paper.

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
        rows: see `evaluate`; trainings that differ in their seed alone are
            one line.
        style: text for a terminal; csv, markdown or latex for a paper.
        width: columns of a terminal; default: the terminal's.
        intervals: whether latex has intervals, too, which is too wide for one column of
            a paper.
        whole: whether text has columns that do not fit in further tables, and a table
            of means.
    """
    names = pl.col("dataset", "model", "checkpoint")
    lines = summarise(rows)
    lines = lines.with_columns(names.map_elements(printable, pl.String))
    if style == "text":
        visible = lines if whole else lines.filter(pl.col("sets") == 1)
        tables = _text_tables(visible, width, whole)
        return "\n".join([tables, *_notes(lines)])
    if style == "latex":
        return _latex_table(lines, intervals)
    if style == "csv":
        return _csv_table(lines)
    return _markdown_table(lines)


def _text_tables(lines: pl.DataFrame, width: int | None, whole: bool) -> str:
    """A table for each test set, see `format_table`; columns that do not fit are in further ones
    or, unless `whole`, left out."""
    width = width or shutil.get_terminal_size().columns
    texts = []
    for metrics, members in _by_test_set(lines):
        facts = members[0].facts
        title = _test_title(facts)
        if facts["sets"] == 1:
            title += f", {facts['scenes']} scenes, {facts['agents']} people"
        texts.append(title)
        models, *rest = _columns(metrics, members)
        while rest:
            taken, rest = _that_fit(rest, width - len(models[0]))
            table = aligned_table(list(zip(models, *taken)))
            texts.append(f"{table}\n")
            if not whole:
                break
    return "\n".join(texts)


def _test_title(facts: Mapping[str, Any]) -> str:
    return f"{facts['dataset']}: {facts['obs_len']} + {facts['pred_len']} steps"


def _that_fit(
    columns: Sequence[list[str]], width: int
) -> tuple[list[list[str]], list[list[str]]]:
    """The columns that fit into `width` letters with two blanks before each, and the others.

    At least one column fits, however narrow the terminal is.
    """
    taken, others = [], []
    for column in columns:
        letters = len(column[0]) + 2
        if letters <= width or not taken:
            taken.append(column)
            width -= letters
        else:
            others.append(column)
    return taken, others


def _columns(metrics: Mapping[str, Metric], members: Sequence[Line]) -> list[list[str]]:
    """Cells of equal width of each column, two rows of head first."""
    columns = []
    for name, metric in metrics.items():
        above, below = _heads(metric)
        cells = _marked([line.cells[name] for line in members])
        columns.append([above, below, *cells])
    samples = ["", "k"]
    rates = ["forecasts", "a second"]
    latencies = ["latency", "in ms"]
    for line in members:
        samples.append(str(line.facts["samples"]))
        rates.append(_rounded(line.facts["forecasts_per_second"], 0))
        latencies.append(_rounded(line.facts["latency"], 1, 1000))
    right = []
    for column in (*columns, samples, rates, latencies):
        width = max(map(len, column))
        right.append([cell.rjust(width) for cell in column])
    models = ["", "model", *(line.label for line in members)]
    width = max(map(len, models))
    return [[cell.ljust(width) for cell in models], *right]


def _heads(metric: Metric) -> tuple[str, str]:
    """The two rows of the head of a metric's column."""
    first, _, rest = metric.title.partition(" ")
    return (first, rest) if rest else ("", first)


def _marked(cells: Sequence[Cell]) -> list[str]:
    """The texts of cells, with `*` behind the best, and a blank behind others then."""
    no_mark = " " if any(cell.best for cell in cells) else ""
    texts = []
    for cell in cells:
        mark = "*" if cell.best else no_mark
        texts.append(cell.mean + cell.half + mark)
    return texts


def _rounded(value: float | None, decimals: int, scale: float = 1) -> str:
    """`value` in other units; `-` for none."""
    if value is None:
        return "-"
    return f"{scale * value:.{decimals}f}"


def _csv_table(lines: pl.DataFrame) -> str:
    """A line each, with unrounded numbers; `_low` and `_high` bound the 95 % interval, `_p` is of
    the paired test against the best."""
    facts = [*FACTS[:4], "checkpoint", "trainings", *FACTS[4:], "learned"]
    index = ["line", *facts]
    wide = lines.pivot("metric", index=index, values=[*ENDS], maintain_order=True)
    columns = []
    for metric in lines["metric"].unique(maintain_order=True):
        for value, ending in ENDS.items():
            column = pl.col(f"{value}_{metric}")
            columns.append(column.alias(f"{metric}{ending}"))
    return csv_text(wide.select(*facts, *columns))


def _markdown_table(lines: pl.DataFrame) -> str:
    """Means with 95 % intervals; the significantly best is bold."""
    metrics = _metrics(lines)
    heads = []
    for metric in metrics.values():
        heads.append(metric.title if metric.unit == "share" else metric.label)
    body = []
    for _, members in _by_test_set(lines):
        for label, facts, cells in members:
            dataset = markdown_text(facts["dataset"])
            row = [dataset, markdown_text(label), str(facts["samples"])]
            for name in metrics:
                mean, interval, _, best = cells[name]
                text = f"**{mean}**" if best else mean
                row.append(text + interval)
            body.append(row)
    return markdown_table(["", "", "k", *heads], body, right=len(heads) + 1)


def _latex_table(lines: pl.DataFrame, intervals: bool) -> str:
    """A `tabular` of booktabs for one column of a paper: the significantly best mean is bold."""
    metrics = _metrics(lines)
    tests = [members for _, members in _by_test_set(lines)]
    above, below = ["", ""], ["", "$k$"]
    heads = [_heads(metric) for metric in metrics.values()]
    for title, group in itertools.groupby(heads, lambda head: head[0]):
        rests = [latex_text(rest) for _, rest in group]
        above.append(rf"\multicolumn{{{len(rests)}}}{{c}}{{{latex_text(title)}}}")
        below += rests
    all_lines = itertools.chain.from_iterable(tests)
    short = short_names(line.label for line in all_lines)
    rows = []
    for members in tests:
        facts = members[0].facts
        steps = f"{facts['obs_len']} + {facts['pred_len']} steps"
        title = latex_text(f"{facts['dataset']}, {steps}")
        rows.append(r"\midrule")
        rows.append(rf"\multicolumn{{{len(below)}}}{{l}}{{\emph{{{title}}}}} \\")
        for label, facts, cells in members:
            row = [latex_text(short[label]), str(facts["samples"])]
            row += [_latex_cell(cells[name], intervals) for name in metrics]
            rows.append(" & ".join(row) + r" \\")
    notes = [f"{brief}: {name}" for name, brief in short.items() if brief != name]
    if any(metric.unit == "m" for metric in metrics.values()):
        notes.append("errors in metres")
    notes += _notes(lines, intervals)
    table = [
        r"% \usepackage{booktabs}",
        *(f"% {note}" for note in notes),
        r"\begingroup\footnotesize\setlength{\tabcolsep}{3pt}",
        rf"\begin{{tabular}}{{@{{}}l{'r' * (len(below) - 1)}@{{}}}}",
        r"\toprule",
        " & ".join(above) + r" \\",
        " & ".join(below) + r" \\",
        *rows,
        r"\bottomrule",
        r"\end{tabular}\endgroup",
    ]
    return "\n".join(table)


def _latex_cell(cell: Cell, intervals: bool) -> str:
    """The mean, bold where it is the best, with the interval if there is one."""
    text = latex_text(cell.mean)
    if cell.best:
        text = rf"\textbf{{{text}}}"
    if intervals and cell.interval:
        text += rf"{{\scriptsize{cell.interval}}}"
    return text


def _cell(metric: Metric, value: Mapping[str, Any]) -> Cell:
    """The cell of a row of `summarise`."""
    if value["mean"] is None:
        return Cell()
    mean = metric.text(value["mean"])
    if value["low"] is None:
        is_few = value["sets"] == 1 and value["blocks"] < FEWEST
        return Cell(mean, " [too few blocks]" if is_few else "")
    low, _, _ = metric.text(value["low"]).partition(" ")
    high, _, _ = metric.text(value["high"]).partition(" ")
    half = ""
    if metric.unit in ("", "m"):
        number = (value["high"] - value["low"]) / 2
        half = f" ±{number:.3f}".replace("±0.", "±.")
    return Cell(mean, f" [{low}, {high}]", half, value["best"])


def _notes(lines: pl.DataFrame, intervals: bool | None = None) -> list[str]:
    """Explanations below a table for a terminal or, given whether it has `intervals`, a paper."""
    notes = [metric.about for metric in _metrics(lines).values()]
    is_single = pl.col("trainings") == 1
    single = lines.filter(is_single)["blocks"].drop_nulls()
    if len(single) and intervals is not False:
        interval = "[ ]: 95 % interval" if intervals else "±: half of a 95 % interval"
        least, most = single.min(), single.max()
        number = f"{least}" if least == most else f"{least} to {most}"
        notes.append(f"{interval} by Student's t over {number} blocks of scenes")
        if (single < FEWEST).any():
            notes.append(
                f"fewer than {FEWEST} blocks say nothing: no interval, no test"
            )
    trainings = lines.filter(~is_single)["trainings"].unique()
    if len(trainings):
        number = ", ".join(map(str, trainings.sort()))
        notes.append(f"{number} trainings: Student's interval of their mean instead")
    if lines["learned"].any():
        notes.append(
            "(learned): was trained on these people, so its errors are too small: "
            "compared with none"
        )
    if lines["online"].any():
        notes.append("online: sees who was there before, and is compared with none")
    if lines["best"].any():
        mark = "*" if intervals is None else "bold"
        notes.append(
            f"{mark}: significantly better than every other (paired tests, 5 %, Holm)"
        )
    return [printable(note) for note in dict.fromkeys(notes) if note]


def _by_test_set(lines: pl.DataFrame) -> Iterator[tuple[dict[str, Metric], list[Line]]]:
    """The metrics that have a value on each test set, and its lines."""
    for _, rows in lines.group_by("dataset", *HORIZON, maintain_order=True):
        groups = []
        for _, line in rows.group_by("line", maintain_order=True):
            groups.append(line.to_dicts())
        models = [(first["model"], first["checkpoint"]) for first, *_ in groups]
        names = labels(models)
        members = []
        for label, values in zip(names, groups):
            facts = values[0]
            if facts["trainings"] > 1:
                label += f" ({facts['trainings']} trainings)"
            if facts["learned"]:
                label += " (learned)"
            cells = {}
            for value in values:
                metric = known_metric(value["metric"])
                cells[value["metric"]] = _cell(metric, value)
            members.append(Line(label, facts, cells))
        yield _metrics(rows), members


def _metrics(lines: pl.DataFrame) -> dict[str, Metric]:
    """The metrics of which some line has a value."""
    counted = lines.filter(pl.col("mean").is_not_null())
    names = counted["metric"].unique(maintain_order=True)
    return {name: known_metric(name) for name in names}
