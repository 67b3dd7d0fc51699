"""Tables of other shapes, turned into one row for each person and moment.

A table may have its frames in names of pictures, people side by side, a point in one
cell, or a time in two columns. Each is one function from a table to a table; a table
that has nothing of the kind stays as it is.
"""

import dataclasses
import re
from collections.abc import Callable, Mapping

import numpy as np
import polars as pl

from neurosym_jax.data.tables import Table, absent, plain_name, role_of, vocabulary

__all__ = ["axes_of", "tidy"]

IMAGE = r"^(.*?)(\d+)\.(?:jpe?g|png|bmp|tiff?|ppm|webp)$"
"""The name of a picture that ends in the number of its frame."""
_WIDE = re.compile(r"(.*?)([ _.-]?)(\d+)([ _.-]?)(.*)")
"""A name with an index: what stands before and after it, and what separates them."""

_NUMBER = r"([+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?|nan)"
POINT = rf"^(?:POINT ?Z? ?)?[\[(] *{_NUMBER}[ ,;]+{_NUMBER}(?:[ ,;]+{_NUMBER})? *[\])]$"
"""A point in a cell: `(x, y)`, `[x y]`, and `POINT (x y)` of WKT."""
QUANTITY = rf"^{_NUMBER} ?([A-Za-zµ]+)$"
"""A number with its unit in a cell: `0.4 sec`."""
HEAD = 100
"""Rows of which one has a point where a column has points."""
FEW = 0.1
"""Share of cells below which others among points are mistakes, not another content."""
PEOPLE_SPAN = 0.5
"""Degrees, some 50 km, that no recording of people spans."""

DIGITS = {"ns": 9, "us": 6, "ms": 3}
"""Digits of a second by the unit of its rest."""


def tidy(table: Table) -> Table:
    """The table with a row for each person and moment, and columns of names, if it says how."""
    steps: tuple[Callable[[Table], Table], ...] = (
        _with_units_of_cells,
        _with_points_of_cells,
        _with_dates,
        _with_whole_times,
        _unfolded,
        _with_frames_of_names,
    )
    for step in steps:
        table = step(table)
    return table


def axes_of(x: np.ndarray, y: np.ndarray) -> tuple[str, str]:
    """Names of two columns [R]: longitude and latitude, unless they are metres of a map.

    In degrees people are within `PEOPLE_SPAN` of each other, few outliers apart; in
    metres they are further apart than that.
    """
    points = np.column_stack([x, y])
    points = points[np.isfinite(points).all(axis=1)]
    if not len(points) or (np.abs(points) > [180, 90]).any():
        return "x", "y"
    low, high = np.quantile(points, [0.05, 0.95], axis=0)
    if (high - low).max() > PEOPLE_SPAN:
        return "x", "y"
    return "longitude", "latitude"


def _with_units_of_cells(table: Table) -> Table:
    """The table with numbers in columns whose cells have a unit, all the same: it joins the name."""
    for at, name in enumerate(table.names):
        texts = table.column(at)
        if role_of(name) in ("", "id", "label"):
            continue
        if not texts.head(HEAD).str.contains(QUANTITY).any():
            continue
        is_missing = absent(texts)
        parts = texts.str.extract_groups(QUANTITY).struct.unnest()
        number, unit = parts.get_columns()
        units = unit.filter(~is_missing).unique().to_list()
        if len(units) != 1 or units[0] is None:
            continue
        named = f"{name} [{units[0]}]"
        known = plain_name(named)[1]
        if known and plain_name(name)[1] in ("", known):
            others = {at: f"{name} (with its unit)"}
            number = number.set(is_missing, "")
            table = _renamed(table, others).with_column(named, number)
    return table


def _with_points_of_cells(table: Table) -> Table:
    """The table with two columns more for each whose cells are points, as `(x, y)`."""
    has_x = "x" in set(map(role_of, table.names))
    columns = {}
    for at, name in enumerate(table.names):
        texts = table.column(at)
        if not texts.head(HEAD).str.contains(POINT).any():
            continue
        others = ~(texts.str.contains(POINT) | absent(texts)).to_numpy()
        if others.mean() <= (0 if has_x else FEW):
            columns[name] = texts
            _refuse_cells(table, others, texts, f"{name} is not a point")
    for name, texts in columns.items():
        x, y = (texts.str.extract(POINT, part).fill_null("") for part in (1, 2))
        axes = (f"{name}.x", f"{name}.y")
        if texts.str.starts_with("POINT").any():
            numbers = [part.cast(pl.Float64, strict=False) for part in (x, y)]
            axes = axes_of(*(part.fill_null(np.nan).to_numpy() for part in numbers))
        elif len(columns) == 1 and not role_of(axes[0]):
            axes = ("x", "y")
        table = table.with_column(axes[0], x).with_column(axes[1], y)
        table = table.noted(f"points are in the cells of {name!r}")
    return table


def _refuse_cells(
    table: Table, wrong: np.ndarray, texts: pl.Series, reason: str
) -> None:
    table.refuse(wrong, lambda row: f"{reason}: {texts[row][:60]!r}")


def _with_dates(table: Table) -> Table:
    """The table with the times of a column of dates and one of clocks."""
    words = [plain_name(name)[0] for name in table.names]
    dates = [at for at, word in enumerate(words) if word in vocabulary()["date"]]
    clocks = [at for at, name in enumerate(table.names) if role_of(name) == "time"]
    if len(dates) != 1 or len(clocks) != 1:
        return table
    date, clock = table.column(dates[0]), table.column(clocks[0])
    are_times = date.str.contains(r"\d[-./]\d") & clock.str.contains(r"^\d+:")
    if not are_times.all():
        return table
    return _with_times(table, (dates[0], clocks[0]), date + " " + clock)


def _with_whole_times(table: Table) -> Table:
    """The table with the times of two columns, of whole seconds and of the rest of a second."""
    if "%time" in table.names:  # As `rostopic echo -p` writes them.
        return _renamed(table, {list(table.names).index("%time"): "time [ns]"})
    places = {}
    for at, name in enumerate(table.names):
        places.setdefault(plain_name(f"of_{name}"), at)
    for (stem, unit), at in places.items():
        for rest, digits in DIGITS.items():
            if unit == "s" and (stem, rest) in places:
                return _with_whole_time(table, at, places[stem, rest], digits)
    return table


def _with_whole_time(table: Table, at: int, other: int, digits: int) -> Table:
    """The table with the time of the columns `at` and `other`, if these are whole seconds and the
    rest of a second, of so many digits; not where they are one time in two units."""
    seconds, rest = (
        table.column(place).str.strip_suffix(".0") for place in (at, other)
    )
    is_missing = absent(seconds) | absent(rest)
    is_whole = seconds.str.contains(r"^\d+$")
    is_rest = rest.str.contains(rf"^\d{{1,{digits}}}$")
    if is_missing.all() or not (is_missing | is_whole & is_rest).all():
        return table
    times = (seconds + "." + rest.str.zfill(digits)).set(is_missing, "")
    return _with_times(table, (at, other), times)


def _with_times(table: Table, places: tuple[int, int], times: pl.Series) -> Table:
    """The table with a column of `times` that two others make up."""
    names = [table.names[at] for at in places]
    others = {at: f"{table.names[at]} (part)" for at in places}
    table = _renamed(table, others).with_column("time [s]", times)
    return table.noted(f"times are {' and '.join(names)}")


def _renamed(table: Table, others: Mapping[int, str]) -> Table:
    """The table with other names of some columns."""
    names = [others.get(at, name) for at, name in enumerate(table.names)]
    return dataclasses.replace(table, names=names)


def _unfolded(table: Table) -> Table:
    """A row for each person, of a table whose columns x and y differ by an index: `t, x1, y1, x2,
    y2`. Ids may differ so, too; else the index is the id, unless there is a column of ids."""
    people = dict[str, dict[str, int]]()
    plain_names = dict[str, str]()
    others = list[int]()
    for at, name in enumerate(table.names):
        index, role, plain = _without_index(name)
        if role:
            people.setdefault(index, {})[role] = at
            plain_names.setdefault(role, plain)
        else:
            others.append(at)
    roles = {frozenset(places) for places in people.values()}
    has_ids = "id" in {role_of(table.names[at]) for at in others}
    is_wide = roles in ({frozenset("xy")}, {frozenset(["x", "y", "id"])})
    if has_ids or not is_wide or len(people) < 2:
        return table
    parts = []
    for person, places in people.items():
        ids = pl.Series([[person]])
        if "id" in places:
            ids = table.column(places["id"])
        chosen = [*others, places["x"], places["y"]]
        parts.append(table.fields.list.gather(chosen).list.concat(ids))
    names = [table.names[at] for at in others]
    row = np.tile(table.row, len(people))
    order = np.argsort(row, kind="stable")
    table = dataclasses.replace(
        table,
        names=[*names, plain_names["x"], plain_names["y"], "id"],
        fields=pl.concat(parts)[order],
        row=row[order],
    )
    return table.noted(f"columns of {len(people)} people side by side")


def _without_index(name: str) -> tuple[str, str, str]:
    """The index, the role and the name without index of a column of one of several people, as
    `x_cm` of `x1_cm`; nothing for others."""
    match = _WIDE.fullmatch(name)
    if match:
        before, separator, index, other_separator, after = match.groups()
        joined = before + (other_separator or separator) + after
        for text in (joined, after, before):
            role = "id" if text == "name" else role_of(text)
            if role in ("id", "x", "y"):
                return index, role, text
    return "", "", name


def _with_frames_of_names(table: Table) -> Table:
    """The table with the frames of a column of names of pictures, unless it has a clock.

    What stands before the numbers tells recordings apart, if it differs.
    """
    roles = list(map(role_of, table.names))
    for at, role in enumerate(roles):
        if role not in ("recording", "frame"):
            continue
        texts = table.column(at)
        if not texts.str.contains(IMAGE).all():
            continue
        name = table.names[at]
        table = _renamed(table, {at: f"name of {name}"})
        if role == "frame" or not {"time", "frame"} & set(roles):
            table = table.with_column("frame", texts.str.extract(IMAGE, 2))
            table = table.noted(f"frames are in the names of {name!r}")
        before = texts.str.extract(IMAGE, 1)
        if before.n_unique() > 1:
            table = table.with_column("recording", before)
        return table
    return table
