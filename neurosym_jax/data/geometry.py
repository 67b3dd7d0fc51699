"""From coordinates of a picture to metres, and back: homographies, scales and handedness.

Positions have x to the right, y up, so that left is counter-clockwise. In pictures y
points down.
"""

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np

from neurosym_jax.data.reading import ReadOptions, metres_in, read_text_file
from neurosym_jax.data.schema import BOX, Schema
from neurosym_jax.data.table import Table
from neurosym_jax.errors import InputError, option

__all__ = ["SWAP", "outside", "positions_of", "project", "read_homography"]

SWAP = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])


def read_homography(text: str | Path) -> np.ndarray:
    """[3, 3] matrix from (column, row, 1) of a picture to metres, of `FILE` or `FILE,row-column`.

    The file has nine numbers; with `row-column` they are for (row, column, 1), as
    EWAP's.

    Raises:
        InputError: naming the file that cannot be used.
    """
    name, _, order = str(text).partition(",")
    if order not in ("", "row-column", "column-row"):
        raise InputError(
            f"{text}: the order of a homography is row-column or column-row"
        )
    fields = read_text_file(Path(name)).replace(",", " ").replace(";", " ").split()
    try:
        matrix = np.array(fields, float).reshape(3, 3)
        if not np.isfinite(np.linalg.inv(matrix)).all():
            raise ValueError("not finite")
    except ValueError as error:  # LinAlgError is one.
        raise InputError(
            f"{name}: 3 x 3 numbers that have an inverse are wanted ({error})"
        ) from None
    return matrix @ SWAP if order == "row-column" else matrix


def project(matrix: np.ndarray, points: np.ndarray) -> np.ndarray:
    """[..., 2] images of `points [..., 2]`; NaN on and behind the horizon.

    The side of the horizon is that of most points.
    """
    mapped = points @ matrix[:, :2].T + matrix[:, 2]
    depth = mapped[..., 2:]
    usable = depth * np.sign(np.median(depth) or 1.0) > 1e-12 * np.abs(depth).max()
    return np.divide(
        mapped[..., :2], depth, out=np.full(points.shape, np.nan), where=usable
    )


def outside(matrix: np.ndarray, points: np.ndarray, width: int, height: int) -> float:
    """Share of `points [P, 2]`, in metres, that lie outside a picture of this size in pixels."""
    pixels = project(np.linalg.inv(matrix), points)
    with np.errstate(invalid="ignore"):
        inside = ((pixels >= -0.5) & (pixels <= [width - 0.5, height - 0.5])).all(
            axis=-1
        )
    return float(1 - inside.mean())


def positions_of(
    table: Table, schema: Schema, options: ReadOptions, unit: str | None
) -> tuple[Table, np.ndarray, np.ndarray, list[str]]:
    """The rows with a position, [R, 2] metres, [R, 2] in the file's unit, and what to warn of.

    `unit` is what the file says of itself.

    Raises:
        InputError: where no row has one, or their unit is not known or said twice.
    """
    places, lines = schema.places, list[str]()
    roles = [role for role in (BOX if schema.is_box else ("x", "y")) if role in places]
    values = table.numbers(*(places[role] for role in roles), missing=True)
    has_position: Any = ~np.isnan(values).any(axis=1)
    if has_position.sum() < len(values):
        if not has_position.any():
            raise InputError(f"{table.path}: no row has a position")
        lines.append(
            f"{np.sum(~has_position)} rows have no position, and are taken as not seen"
        )
        table, values = table.take(has_position), values[has_position]
    column = dict(zip(roles, values.T))
    if schema.is_box:
        right = (
            column["right"] if "right" in column else column["left"] + column["width"]
        )
        bottom = (
            column["bottom"] if "bottom" in column else column["top"] + column["height"]
        )
        wrong = (right < column["left"]) | (bottom < column["top"])
        table.refuse(
            wrong, lambda at: "the box ends before it begins (left top right bottom)"
        )
        raw = np.column_stack([(column["left"] + right) / 2, bottom])
    else:
        raw = values
    stated = options.unit_of(table.path.stem)
    if unit and stated and abs(metres_in(stated) / metres_in(unit) - 1) > 1e-6:
        if "scale" not in options.allow:
            raise InputError(
                f"{table.path}: the file says that coordinates are {unit}, "
                f"{option('unit', stated)}: which is right? ({option('allow', ('scale',))} takes "
                "the option)"
            )
        lines.append(f"allowed scale: the file says {unit}, {option('unit', stated)}")
    if schema.in_picture and not (stated or unit or options.homography):
        raise InputError(
            f"{table.path}: positions are pixels of a picture: say what they are in metres, by "
            f"{option('homography', 'FILE')} or metres of a pixel, {option('unit', '0.032')}"
        )
    if options.homography:
        position = project(read_homography(options.homography), raw)
        table.refuse(
            np.isnan(position).any(axis=1),
            lambda at: f"{raw[at]} lies beyond the homography's horizon",
        )
        position = position * metres_in(stated or "m")
    else:
        position = raw * metres_in(stated or unit or "m")
        if schema.in_picture:
            position = position * [1, -1]  # Rows of pictures count downward.
    if options.flip_y or (schema.in_picture and not options.homography):
        table = dataclasses.replace(
            table, notes=(*table.notes, "y is turned round, to point up")
        )
    return table, position * [1, -1 if options.flip_y else 1], raw, lines
