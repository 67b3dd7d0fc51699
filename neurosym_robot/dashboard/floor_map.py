"""A ROS map (map.yaml and its image) as the page draws it: how occupied each cell is."""

import base64
import io
import math
from pathlib import Path
from typing import Any

import numpy as np

from neurosym_jax.errors import InputError

__all__ = ["read_floor_map"]

LARGEST = 4096  # pixels along a side; larger maps are shown coarser
UNKNOWN = 48  # opacity of cells of which nothing is known, of 255


def read_floor_map(path: Path) -> dict[str, Any]:
    """A map as ROS's map_server saves it.

    Args:
        path: the `.yaml` file with `image`, `resolution` [m a pixel], `origin` [x, y, yaw] of the
            lower left corner in metres and radians, `negate`, `occupied_thresh`, `free_thresh`
            and `mode` (trinary, scale or raw; raw is shown as scale).

    Returns:
        `image`, a PNG as data URL whose opacity is how occupied a cell is; `width` and `height`
        [m]; and `origin`.

    Raises:
        InputError: naming the file and what is wrong with it.
    """
    import yaml

    try:
        said = yaml.safe_load(path.read_text())
        resolution, name = float(said["resolution"]), str(said["image"])
        x, y, yaw = (float(value) for value in said["origin"])
        negate = bool(int(said.get("negate", 0)))
        occupied, free = (
            float(said.get(key, usual))
            for key, usual in (("occupied_thresh", 0.65), ("free_thresh", 0.196))
        )
        trinary = said.get("mode", "trinary") == "trinary"
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror})") from None
    except (yaml.YAMLError, UnicodeDecodeError, KeyError, TypeError, ValueError, AttributeError):
        raise InputError(
            f"{path}: not a map; image, resolution and origin [x, y, yaw] are needed"
        ) from None
    if not (0 < resolution < math.inf and all(map(math.isfinite, (x, y, yaw)))):
        raise InputError(f"{path}: resolution must be positive and the origin finite")
    grey = _read_grey(path.parent / name)
    chance = grey if negate else 1 - grey
    opacity = chance.copy()
    if trinary:
        opacity = np.where(chance > occupied, 1.0, np.where(chance < free, 0.0, UNKNOWN / 255))
    return {
        "image": _png(opacity),
        "width": round(grey.shape[1] * resolution, 6),
        "height": round(grey.shape[0] * resolution, 6),
        "origin": [x, y, yaw],
    }


def _read_grey(path: Path) -> np.ndarray:
    """[rows, columns] in 0 (black) .. 1 (white)."""
    from PIL import Image, UnidentifiedImageError

    try:
        with Image.open(path) as image:
            # Sixteen bits become eight only by hand: `convert` would cut them off.
            deep = image.mode.startswith("I")
            pixels = np.asarray(image if deep else image.convert("L"), np.float64)
    except (UnidentifiedImageError, Image.DecompressionBombError, ValueError):
        raise InputError(f"{path}: not an image") from None
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror or error})") from None
    return np.clip(pixels / (65535 if deep else 255), 0, 1)


def _png(opacity: np.ndarray) -> str:
    """A data URL; black, as opaque as `opacity [rows, columns]` in 0 .. 1."""
    from PIL import Image

    alpha = Image.fromarray(np.rint(255 * opacity).astype(np.uint8))
    alpha.thumbnail((LARGEST, LARGEST))
    image = Image.new("LA", alpha.size)
    image.putalpha(alpha)
    file = io.BytesIO()
    image.save(file, "PNG", optimize=True)
    return "data:image/png;base64," + base64.b64encode(file.getvalue()).decode()
