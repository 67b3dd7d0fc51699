"""From coordinates of a picture to metres, and back: homographies, scales and handedness.

Positions have x to the right, y up, so that left is counter-clockwise. In pictures y points down.
"""

from pathlib import Path

import numpy as np

from neurosym_jax.data.reading import read_text_file
from neurosym_jax.errors import InputError

__all__ = ["SWAP", "outside", "project", "read_homography"]

SWAP = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])


def read_homography(text: str | Path) -> np.ndarray:
    """[3, 3] matrix from (column, row, 1) of a picture to metres, of `FILE` or `FILE,row-column`.

    The file has nine numbers; with `row-column` they are for (row, column, 1), as EWAP's.

    Raises:
        InputError: naming the file that cannot be used.
    """
    name, _, order = str(text).partition(",")
    if order not in ("", "row-column", "column-row"):
        raise InputError(f"{text}: the order of a homography is row-column or column-row")
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
    return np.divide(mapped[..., :2], depth, out=np.full(points.shape, np.nan), where=usable)


def outside(matrix: np.ndarray, points: np.ndarray, width: int, height: int) -> float:
    """Share of `points [P, 2]`, in metres, that lie outside a picture of this size in pixels."""
    pixels = project(np.linalg.inv(matrix), points)
    with np.errstate(invalid="ignore"):
        inside = ((pixels >= -0.5) & (pixels <= [width - 0.5, height - 0.5])).all(axis=-1)
    return float(1 - inside.mean())
