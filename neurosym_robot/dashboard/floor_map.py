"""A ROS map (map.yaml and its image) as the page draws it: how occupied each cell is."""

import base64
import io
from pathlib import Path
from typing import Any

import numpy as np

from neurosym_jax.errors import InputError

__all__ = ["read_floor_map"]

LARGEST = 4096  # pixels along a side; larger maps are shown coarser
UNKNOWN = 48  # opacity of cells of which nothing is known, of 255


def read_floor_map(path: Path) -> dict[str, Any]:
    """A map as ROS's map_server saves it: a `.yaml` file that names an image.

    Returns:
        `image`, a PNG as data URL whose opacity is how occupied a cell is; `width` and `height`
        [m]; and `origin` [x, y, yaw] of the lower left corner in metres and radians.

    Raises:
        InputError: naming the file and what is wrong with it.
    """
    import yaml
    from PIL import Image

    try:
        said = {"negate": 0, "occupied_thresh": 0.65, "free_thresh": 0.196}
        said |= yaml.safe_load(path.read_text())
        resolution = float(said["resolution"])
        x, y, yaw = map(float, said["origin"])
        if not (resolution > 0 and np.isfinite([resolution, x, y, yaw]).all()):
            raise ValueError("resolution must be positive and the origin finite")
        with Image.open(path.parent / str(said["image"])) as image:
            grey = np.asarray(image.convert("L"), np.float64) / 255
        chance = grey if int(said["negate"]) else 1 - grey
        occupied, free = (
            chance > float(said["occupied_thresh"]),
            chance < float(said["free_thresh"]),
        )
    except (OSError, ValueError, TypeError, LookupError, yaml.YAMLError) as error:
        reason = " ".join(str(error).split())
        raise InputError(
            f"{path}: not a map with image, resolution and origin ({reason})"
        ) from None
    alpha = Image.fromarray(np.where(occupied, 255, np.where(free, 0, UNKNOWN)).astype(np.uint8))
    alpha.thumbnail((LARGEST, LARGEST))
    picture = Image.new("LA", alpha.size)
    picture.putalpha(alpha)
    file = io.BytesIO()
    picture.save(file, "PNG", optimize=True)
    return {
        "image": "data:image/png;base64," + base64.b64encode(file.getvalue()).decode(),
        "width": round(grey.shape[1] * resolution, 6),
        "height": round(grey.shape[0] * resolution, 6),
        "origin": [x, y, yaw],
    }
