"""Model folders of format 1, whose parameters Orbax wrote: read, so that they can be converted."""

import json
import math
from pathlib import Path
from typing import Any

from neurosym_jax.config import GeneratorConfig
from neurosym_jax.configuration import from_json
from neurosym_jax.errors import InputError
from neurosym_jax.forecasting.model import Model
from neurosym_jax.forecasting.model_folder import refuse_misfit
from neurosym_jax.training.arrays import array_shapes, digest, read_arrays

__all__ = ["load_old_model"]

LARGEST_RATIO = 16
"""Of the parameters' bytes to those of the files that hold them compressed."""


def load_old_model(folder: Path, config: bytes) -> Model:
    """Read `folder`, whose `config.json` holds `config`.

    The digest of this format is of the parameters alone, once they are read: a damaged file may ask
    for any amount of memory, and the configuration may describe another network.

    Raises:
        InputError: for anything that is not such a folder, or is damaged.
    """
    source = "config.json"
    try:
        data: Any = json.loads(config)
        fields = ("format", "generator", "scene", "sha256")
        if not isinstance(data, dict) or set(data) != set(fields):
            raise InputError(f"{source}: must have exactly the fields {', '.join(fields)}")
        generator = {**data["generator"], "format": data["format"]}
    except (ValueError, TypeError, RecursionError) as error:
        raise InputError(f"{source}: not a model's configuration ({error})") from None
    if type(data["format"]) is not int or not isinstance(data["scene"], str | None):
        raise InputError(f"{source}: format or scene is of the wrong type")
    arrays = folder / "params"
    there = sum(path.stat().st_size for path in arrays.rglob("*") if path.is_file())
    needed = sum(8 * math.prod(shape) for shape in array_shapes(arrays))
    if needed > LARGEST_RATIO * there:
        raise InputError(f"damaged: {there} bytes cannot hold the {needed} bytes of the parameters")
    config_of = from_json(GeneratorConfig, generator, source)
    params = read_arrays(arrays)
    if digest(params) != data["sha256"]:
        raise InputError(f"damaged: the parameters do not match the digest in {source}")
    model = Model(config_of, params, data["scene"])
    refuse_misfit(model)
    return model
