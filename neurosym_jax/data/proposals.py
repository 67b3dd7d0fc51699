"""Which columns may be the clock, the id and positions, by their values alone."""

import itertools
from collections.abc import Mapping
from typing import Any

import numpy as np

from neurosym_jax.data.evidence import roughness
from neurosym_jax.data.table import Table, absent

__all__ = ["propose"]

ROUGHEST = 0.5
"""Sum of the roughness of x and y above which nothing is proposed: of 7 tables of walkers it is at
most 0.06, of boxes of one moment in seven cameras 1.3."""
SET_BACK = 10.0
"""Roughness that is added to what may be a height; that of a track is less."""


def propose(table: Table, places: Mapping[str, int]) -> dict[str, int]:
    """Columns for the roles that are missing, by values: the reading whose tracks are smoothest.

    The id repeats, the clock is a number; x and y follow each other, perhaps with one
    between.
    """
    part, columns = (
        table.take(np.arange(len(table.row)) < 20_000),
        range(min(len(table.names), 12)),
    )
    is_complete = ~np.any(
        [absent(part.column(at)).to_numpy() for at in columns], axis=0
    )
    if is_complete.mean() > 0.25:  # Of people who are not seen there is no position.
        part = part.take(is_complete)
    free = [at for at in columns if at not in places.values()]
    clock = places.get("time", places.get("frame"))
    x, y = places.get("x", places.get("left")), places.get("y", places.get("top"))
    numbers = {
        at: values
        for at in dict.fromkeys([*free, clock, x, y])
        if at is not None and (values := _numbers(part, at)) is not None
    }
    moments: list[int] = (
        [clock] if clock is not None else [at for at in free if at in numbers]
    )
    people = (
        [places["id"]] if "id" in places else [at for at in free if _repeats(part, at)]
    )
    pairs = [
        (a, b) for a, b in itertools.combinations(sorted(numbers), 2) if b - a <= 2
    ]
    pairs = [
        (a, b)
        for a, b in pairs
        if a in (x, a * (x is None)) and b in (y, b * (y is None))
    ]
    pairs: Any = pairs if x is None or y is None else [(x, y)]
    lowest, best = np.inf, dict[str, Any]()
    for moment, person in itertools.product(moments, people):
        if moment == person or moment not in numbers:
            continue
        ids = part.column(person).rank("dense").to_numpy()
        bends = roughness(numbers[moment], ids, np.column_stack(list(numbers.values())))
        # One number at a moment, whoever is there, is another clock; one of a person
        # may be a height, and is taken for a coordinate only where nothing else is
        # left.
        bend = dict[int, float]()
        for at, value in zip(numbers, bends):
            at_once, in_all = (
                len(np.unique(key + 1j * numbers[at])) > 1.2 * len(np.unique(key))
                for key in (numbers[moment], ids)
            )
            if at_once:
                bend[at] = value + SET_BACK * (not in_all)
        for pair in pairs:
            if {moment, person} & set(pair) or not all(at in bend for at in pair):
                continue
            if (
                score := bend[pair[0]] + bend[pair[1]]
            ) < 0.7 * lowest:  # Of readings alike the first.
                lowest, is_whole = score, (numbers[moment] % 1 == 0).all()
                best = {"frame" if is_whole else "time": moment, "id": person}
                best |= {"x": pair[0], "y": pair[1]}
    if lowest % SET_BACK > ROUGHEST:
        return {}
    occupied = {*places, *(("time", "frame") if clock is not None else ())}
    occupied |= {"x", "y"} if "left" in places else set()
    return {role: at for role, at in best.items() if role not in occupied}


def _numbers(table: Table, at: int) -> Any:
    """[R] numbers of a column; None where most fields are others."""
    values = table.extra(at, texts=False)
    return np.nan_to_num(values) if np.isfinite(values).mean() > 0.5 else None


def _repeats(table: Table, at: int) -> bool:
    """Whether a column's values repeat, as ids do; fractions never do."""
    texts = table.column(at)
    values = table.extra(at, texts=False)
    is_whole = not np.isfinite(values).any() or (np.nan_to_num(values) % 1 == 0).all()
    return bool(is_whole and 2 * texts.n_unique() <= len(texts))
