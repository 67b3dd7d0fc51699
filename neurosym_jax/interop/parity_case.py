"""The content of a golden case: checked arrays, scenes and configurations."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from neurosym_jax.data.batching import gather_scenes
from neurosym_jax.data.windows import Windows
from neurosym_jax.errors import InputError
from neurosym_jax.forecasting.batched import unpacked
from neurosym_jax.interop.arguments import RENAMED_ARGUMENTS, generator_config
from neurosym_jax.models.config import GeneratorConfig
from neurosym_jax.scene import Scene

__all__ = [
    "Arrays",
    "Compared",
    "case_scenes",
    "floats",
    "generator_of",
    "manifest_field",
    "placed",
    "scenes_of",
    "state_dict",
    "whole_numbers",
]

Arrays = Mapping[str, np.ndarray]
Compared = dict[str, tuple[np.ndarray, np.ndarray]]
"""Per output, ours and theirs, of one shape."""


def floats(arrays: Arrays, name: str, *shape: int | None) -> np.ndarray:
    """The finite floating-point array `name` of this shape; None is any size.

    Raises:
        InputError: naming the array and what is wrong with it.
    """
    array = _array(arrays, name, shape, "f", "floating point")
    if not np.isfinite(array).all():
        raise InputError(f"{name!r} holds a value that is not finite")
    return array


def whole_numbers(arrays: Arrays, name: str, *shape: int | None) -> np.ndarray:
    """The array `name` of whole numbers of this shape; None is any size.

    Raises:
        InputError: naming the array and what is wrong with it.
    """
    return _array(arrays, name, shape, "iu", "whole numbers")


def state_dict(arrays: Arrays, prefix: str) -> dict[str, np.ndarray]:
    """The state dict that is stored under `prefix`."""
    return {k.removeprefix(prefix): v for k, v in arrays.items() if k.startswith(prefix)}


def case_scenes(config: GeneratorConfig, arrays: Arrays) -> tuple[Windows, Scene]:
    """The S scenes of a case, as stored and as one batch with the stored displacements.

    Raises:
        InputError: for an array that is missing or wrong.
    """
    traj = floats(arrays, "traj", None, config.obs_len + config.pred_len, 2)
    moves = floats(arrays, "traj_rel", *traj.shape)
    bounds = whole_numbers(arrays, "scene_start_end", None, 2)
    if not len(bounds):
        raise InputError("'scene_start_end' must be of at least one scene")
    starts, ends = bounds.astype(np.int64).T
    follows = np.array_equal(starts, [0, *ends[:-1]]) and ends[-1] == len(traj)
    if not follows or (ends <= starts).any():
        raise InputError(
            f"'scene_start_end' does not cut {len(traj)} agents into scenes one after another"
        )
    agents, identity = np.arange(len(traj)), np.zeros((len(ends), 2), np.uint32)
    windows = Windows(traj.astype(np.float64), agents, np.append(0, ends), identity, config.obs_len)
    return windows, scenes_of(windows, moves)


def scenes_of(windows: Windows, moves: np.ndarray) -> Scene:
    """All scenes padded to one size, so that a case is compiled once; [S, ...] on every array.

    `moves [A, T, 2]` are the displacements of the agents; the first ones are taken.
    """
    every = np.arange(windows.scenes)
    scenes = gather_scenes(windows, every, int(windows.sizes.max()))
    observed = moves[:, : windows.obs_len].astype(scenes.observed.dtype)
    displacement = placed(observed, np.asarray(scenes.valid))
    return scenes.replace(displacement=displacement, identity=None)


def placed(values: np.ndarray, there: np.ndarray) -> np.ndarray:
    """`values [A, ...]` in the A places `there [S, ...]` (bool) of zeros: `[S, ..., ...]`."""
    return unpacked(values[None], there)[0]


def generator_of(row: Mapping[str, Any]) -> GeneratorConfig:
    """The generator of a row, whose `variant`, if any, is NeuroSyM's pooling.

    Raises:
        InputError: for an argument that is missing or that no network of ours has.
    """
    renamed = {theirs: manifest_field(row, ours) for ours, theirs in RENAMED_ARGUMENTS.items()}
    return generator_config({**row, **renamed}, "manifest", variant=row.get("variant"))


def manifest_field(row: Mapping[str, Any], name: str) -> Any:
    """The field `name` of a row.

    Raises:
        InputError: where it is missing.
    """
    if name not in row:
        raise InputError(f"manifest: {name} is missing")
    return row[name]


def _array(
    arrays: Arrays, name: str, shape: tuple[int | None, ...], kinds: str, words: str
) -> np.ndarray:
    if name not in arrays:
        raise InputError(f"the array {name!r} is missing")
    array = arrays[name]
    if array.ndim != len(shape) or any(b not in (None, a) for a, b in zip(array.shape, shape)):
        wanted = ", ".join("any" if size is None else str(size) for size in shape)
        raise InputError(f"{name!r} has the shape {list(array.shape)}, not [{wanted}]")
    if array.dtype.kind not in kinds:
        raise InputError(f"{name!r} is {array.dtype}, not {words}")
    return array
