"""What a table says of its own clock, scale and kinds, beside positions: the witnesses.

Comments, names, velocity columns, what a database stores and files beside the table
each give a rate or a unit. Two that contradict each other are refused, and both are
named.
"""

import contextlib
import glob
import json
import re
from pathlib import Path

import numpy as np
import polars as pl

from neurosym_jax.data.reading import metres_in
from neurosym_jax.data.schema import Schema, plain_name, role_of
from neurosym_jax.data.table import Table, read_table
from neurosym_jax.errors import InputError

__all__ = ["RATES", "facts_of", "kinds_beside", "velocity_ratio"]

_RATE = re.compile(
    r"\b(frame[\s_-]*rate|fps|frames?[\s_-]*per[\s_-]*second)\b\W*(\d+(?:\.\d+)?)|"
    r"(\d+(?:\.\d+)?)\s*(?:fps|frames per second)\b",
    re.IGNORECASE,
)
_UNIT = re.compile(
    r"\b(?:unit|units|coordinates|positions|x|y)\b[^\n]{0,20}?\b(metres?|meters?|m|cm|mm)\b",
    re.IGNORECASE,
)
RATES = ("framerate", "fps", "framespersecond")  # plain names of a rate
ENOUGH = 100  # rows from which velocities are a witness


def facts_of(table: Table, schema: Schema) -> dict[str, str]:
    """What is said of `fps` and `unit`, and by whom: `fps_by`, `unit_by`.

    Raises:
        InputError: where x and y have two units, or two places two rates.
    """
    facts = dict[str, str]()

    def add(key: str, value: str, witness: str) -> None:
        number = metres_in if key == "unit" else float
        if key in facts and number(facts[key]) != number(value):
            raise InputError(
                f"{table.path}: {facts[key + '_by']} says {key} {facts[key]}, {witness} {value}: "
                "which is right?"
            )
        facts.setdefault(key, value)
        facts.setdefault(f"{key}_by", witness)

    for role in ("x", "y", "left"):
        unit = schema.units.get(role)
        if unit and unit != "px":
            add("unit", unit, f"the name {table.names[schema.places[role]]!r}")
    for key, value in table.facts.items():
        add(key, value, "the file")
    for comment in table.comments:
        comment = re.sub(r"\[[^]]*\d[^]]*\]", "", comment)  # [1/s] is no rate
        if match := _RATE.search(comment):
            add("fps", match[2] or match[3], f"the comment {comment[:40]!r}")
        names = comment.split()
        if (
            "unit" not in facts
            and len(names) != len(table.names)
            and (match := _UNIT.search(comment))
        ):
            add(
                "unit",
                plain_name(f"x [{match[1]}]")[1],
                f"the comment {comment[:40]!r}",
            )
    for path in _beside(table.path):
        for key, value in _facts_in(path).items():
            add(key, value, path.name)
    return facts


def _beside(path: Path) -> list[Path]:
    """Files of metadata beside a table: 00_tracks.csv has 00_tracksMeta.csv, a.csv a_meta.json."""
    if not path.suffix or not path.parent.is_dir():
        return []
    stem = path.stem.rpartition("_")[0] or path.stem
    return [
        other
        for other in sorted(path.parent.glob(f"{glob.escape(stem)}*[mM]eta*"))
        if other != path and other.suffix.lower() in (".csv", ".json")
    ]


def _facts_in(path: Path) -> dict[str, str]:
    """A rate and a unit in a file of metadata; nothing where it cannot be read."""
    fields = {}
    if path.suffix.lower() == ".json":
        with contextlib.suppress(OSError, ValueError):
            fields = json.loads(path.read_text(encoding="utf-8"))
        fields = fields if isinstance(fields, dict) else {}
    elif (table := _table_in(path)) and len(table.row) == 1:
        fields = {name: table.column(at)[0] for at, name in enumerate(table.names)}
    facts = {}
    for name, value in fields.items():
        if plain_name(name)[0] in RATES:
            with contextlib.suppress(TypeError, ValueError):
                facts["fps"] = str(float(value))
        elif plain_name(name)[0] in ("unit", "units") and plain_name(f"x [{value}]")[1]:
            facts["unit"] = plain_name(f"x [{value}]")[1]
    return facts


def _table_in(path: Path) -> Table | None:
    with contextlib.suppress(InputError):
        return read_table(path)
    return None


def kinds_beside(table: Table, schema: Schema) -> tuple[str, pl.Series] | None:
    """Name and [R] lower-case kinds of the rows' ids, as a file beside the table says."""
    for path in _beside(table.path):
        other = _table_in(path) if path.suffix.lower() == ".csv" else None
        if other is None:
            continue
        roles = [role_of(name) for name in other.names]
        if "id" in roles and "label" in roles and not {"x", "y"} & set(roles):
            ids, kinds = (other.column(roles.index(role)) for role in ("id", "label"))
            kind = dict(zip(ids, kinds.str.to_lowercase()))
            rows = table.column(schema.places["id"]).replace_strict(
                kind, default="", return_dtype=pl.String
            )
            return f"{other.names[roles.index('label')]} in {path.name}", rows
    return None


def velocity_ratio(
    table: Table,
    schema: Schema,
    ids: np.ndarray,
    stamp: np.ndarray,
    position: np.ndarray,
) -> float | None:
    """Units of `stamp` in a second by the columns vx, vy: velocity over displacement per stamp.

    Over four rows, so that rounding and noise matter little; None without columns that
    point where people go. `ids`, `stamp` are [R], `position` is [R, 2].
    """
    if not {"vx", "vy"} <= schema.places.keys():
        return None
    velocity = table.numbers(schema.places["vx"], schema.places["vy"], missing=True)
    order = np.lexsort((stamp, ids))
    ids, stamp = ids[order], stamp[order]
    position, velocity = position[order], np.nan_to_num(velocity[order])
    same = np.flatnonzero((ids[4:] == ids[:-4]) & (stamp[4:] > stamp[:-4]))
    if len(same) < ENOUGH:
        return None
    moved = (position[same + 4] - position[same]) / (stamp[same + 4] - stamp[same])[
        :, None
    ]
    weights = np.array([0.125, 0.25, 0.25, 0.25, 0.125])
    mean = np.einsum("l,lnd->nd", weights, velocity[same + np.arange(5)[:, None]])
    pairs = (mean, moved), (moved, moved), (mean, mean)
    across, length, speed = ((first * other).sum(axis=1) for first, other in pairs)
    moving = (length > 0.01 * np.median(length)) & (speed > 0) & (length > 0)
    if not moving.any():
        return None
    across, length, speed = across[moving], length[moving], speed[moving]
    # Medians, for velocities are wrong where tracks begin or are exchanged.
    cosine = np.median(across / np.sqrt(length * speed))
    return float(np.median(across / length)) if cosine > 0.9 else None
