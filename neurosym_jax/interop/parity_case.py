"""What a golden case must hold: arrays, scenes and configurations, or a word on what is wrong.

How a case's networks compare is said by `interop.parity_networks` and the others; files and tables
are `interop.parity`'s.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np

from neurosym_jax.configuration import from_json
from neurosym_jax.data.batching import gather_scenes
from neurosym_jax.data.windows import Windows
from neurosym_jax.errors import InputError
from neurosym_jax.forecasting.batched import unpacked
from neurosym_jax.interop.torch import (
    POOLING_ARGUMENTS,
    RENAMED_ARGUMENTS,
    SAME_NAME_ARGUMENTS,
    TORCH_POOLING,
    nest_pooling,
)
from neurosym_jax.models.config import DiscriminatorConfig, GeneratorConfig
from neurosym_jax.scene import Scene

__all__ = [
    "Arrays",
    "Compared",
    "case_scenes",
    "discriminator_config",
    "floats",
    "generator_config",
    "manifest_field",
    "placed",
    "scenes_of",
    "state_dict",
    "whole_numbers",
]

SOCIAL_ONLY = ("neighborhood_size", "grid_size")
FIXED = {"batch_norm": False, "num_layers": 1, "activation": "relu"}
"""What SGAN's constructors also take and our networks have in one form only."""

Arrays = Mapping[str, np.ndarray]
Compared = dict[str, tuple[np.ndarray, np.ndarray]]
"""Per output, ours and theirs, of one shape."""


def floats(arrays: Arrays, name: str, *shape: int | None) -> np.ndarray:
    """Floating-point array `name`, once it is finite and has `shape`, where None is any size.

    Raises:
        InputError: naming the array and what is wrong with it.
    """
    array = _of_shape(arrays, name, shape)
    if array.dtype.kind != "f":
        raise InputError(f"{name!r} is {array.dtype}, not floating point")
    if not np.isfinite(array).all():
        raise InputError(f"{name!r} holds a value that is not finite")
    return array


def whole_numbers(arrays: Arrays, name: str, *shape: int | None) -> np.ndarray:
    """Array `name` of whole numbers, once it has `shape`, where None is any size.

    Raises:
        InputError: naming the array and what is wrong with it.
    """
    array = _of_shape(arrays, name, shape)
    if array.dtype.kind not in "iu":
        raise InputError(f"{name!r} is {array.dtype}, not whole numbers")
    return array


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


def generator_config(row: Mapping[str, Any]) -> GeneratorConfig:
    """The configuration of a row, whose `variant`, where it has one, is NeuroSyM's pooling.

    Raises:
        InputError: for a field of the row that no configuration of ours has.
    """
    pooling = manifest_field(row, "pooling_type")
    named: dict[Any, Any] = {theirs: ours for ours, theirs in TORCH_POOLING.items()}
    named[None] = "none"
    if "variant" in row:
        named = {"pool_net": row["variant"]}
    if not isinstance(pooling, str | None) or pooling not in named:
        allowed = ", ".join("null" if name is None else repr(name) for name in named)
        raise InputError(f"manifest: pooling_type is one of {allowed}, not {pooling!r}")
    for name, value in FIXED.items():
        if row.get(name, value) != value:
            raise InputError(f"manifest: {name} = {row[name]!r}, and ours is always {value!r}")
    noise_dim = manifest_field(row, "noise_dim")
    if isinstance(noise_dim, list) and len(noise_dim) == 1:
        noise_dim = noise_dim[0]
    fields = {"noise_dim": noise_dim}
    for name in (*SAME_NAME_ARGUMENTS, *POOLING_ARGUMENTS, *RENAMED_ARGUMENTS):
        if name not in SOCIAL_ONLY or pooling == "spool":
            fields[name] = manifest_field(row, name)
    nest_pooling(fields, named[pooling])
    return from_json(GeneratorConfig, fields, "manifest")


def discriminator_config(row: Mapping[str, Any]) -> DiscriminatorConfig:
    """The discriminator of a row that has one."""
    theirs = {"kind": "d_type", "h_dim": "encoder_h_dim_d"}
    theirs |= {name: name for name in ("embedding_dim", "mlp_dim")}
    fields = {ours: manifest_field(row, name) for ours, name in theirs.items()}
    return from_json(DiscriminatorConfig, fields, "manifest")


def manifest_field(row: Mapping[str, Any], name: str) -> Any:
    """What the row says of `name`.

    Raises:
        InputError: where it says nothing.
    """
    if name not in row:
        raise InputError(f"manifest: the row has no {name!r}")
    return row[name]


def _of_shape(arrays: Arrays, name: str, shape: tuple[int | None, ...]) -> np.ndarray:
    if name not in arrays:
        raise InputError(f"the array {name!r} is missing")
    array = arrays[name]
    if array.ndim != len(shape) or any(b not in (None, a) for a, b in zip(array.shape, shape)):
        wanted = ", ".join("any" if size is None else str(size) for size in shape)
        raise InputError(f"{name!r} has the shape {list(array.shape)}, not [{wanted}]")
    return array
