"""Parity of networks: a case's weights through our conversion, its inputs through our networks.

It takes what a case must hold out of its file's arrays and says what is missing or wrong; files and
tables are `interop.parity`'s, NeuroSyM and its symbols `interop.parity_symbols`'s.
"""

import functools
from collections.abc import Mapping, Sequence
from typing import Any

import jax
import numpy as np
from jax import Array
from jax.typing import ArrayLike

from neurosym_jax.config import FORMAT, DiscriminatorConfig, GeneratorConfig, from_json
from neurosym_jax.errors import InputError
from neurosym_jax.interop.names import discriminator_params_from_torch, generator_params_from_torch
from neurosym_jax.interop.torch import RENAMED_ARGUMENTS, SAME_NAME_ARGUMENTS, TORCH_POOLING
from neurosym_jax.models import Discriminator, Generator
from neurosym_jax.scene import Scene, make_scene, model_dtype, pad_scene, to_world

__all__ = [
    "Arrays",
    "Compared",
    "discriminator_config",
    "floats",
    "forecasts",
    "generator_config",
    "make_scenes",
    "manifest_field",
    "scene_bounds",
    "scene_noise",
    "sgan",
    "stacked",
    "state_dict",
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
    if name not in arrays:
        raise InputError(f"the array {name!r} is missing")
    array = arrays[name]
    if array.ndim != len(shape) or any(b not in (None, a) for a, b in zip(array.shape, shape)):
        wanted = ", ".join("any" if size is None else str(size) for size in shape)
        raise InputError(f"{name!r} has the shape {list(array.shape)}, not [{wanted}]")
    if array.dtype.kind != "f":
        raise InputError(f"{name!r} is {array.dtype}, not floating point")
    if not np.isfinite(array).all():
        raise InputError(f"{name!r} holds a value that is not finite")
    return array


def state_dict(arrays: Arrays, prefix: str) -> dict[str, np.ndarray]:
    """The state dict that is stored under `prefix`."""
    return {k.removeprefix(prefix): v for k, v in arrays.items() if k.startswith(prefix)}


def sgan(row: Mapping[str, Any], arrays: Arrays) -> Compared:
    """The generator's outputs and, where the row says `d_type`, the discriminator's scores.

    The discriminator sees torch's forecast, not ours, so that a fault of the generator is not
    reported twice.
    """
    config = generator_config(row)
    params = generator_params_from_torch(state_dict(arrays, "g_state/"), config)
    traj = floats(arrays, "traj", None, config.obs_len + config.pred_len, 2)
    agents, steps, _ = traj.shape
    traj_rel = floats(arrays, "traj_rel", agents, steps, 2)
    bounds = scene_bounds(arrays, agents)
    observed, observed_rel = traj[:, : config.obs_len], traj_rel[:, : config.obs_len]
    outputs = (agents, config.pred_len, 2)
    pred_rel = floats(arrays, "pred_rel", *outputs)
    pred_abs = floats(arrays, "pred_abs", *outputs)

    scenes = make_scenes(observed, observed_rel, bounds)
    noise = scene_noise(config, arrays, agents, bounds)
    forecast = forecasts(config, params, stacked(scenes, bounds), noise)
    ours_rel = [np.asarray(part)[: b - a] for part, (a, b) in zip(forecast, bounds)]
    ours_abs = [
        to_world(np.asarray(scene.observed)[:, -1:] + np.cumsum(part, axis=1), scene)
        for scene, part in zip(scenes, ours_rel)
    ]
    compared = {
        "pred_rel": (np.concatenate(ours_rel), pred_rel),
        "pred_abs": (np.concatenate(ours_abs), pred_abs),
    }
    if "d_type" in row:
        d_config = discriminator_config(row)
        d_params = discriminator_params_from_torch(state_dict(arrays, "d_state/"), d_config)
        theirs = floats(arrays, "d_scores_fake", agents)
        fake = np.concatenate([observed, pred_abs], axis=1)
        fake_rel = np.concatenate([observed_rel, pred_rel], axis=1)
        fakes = stacked(make_scenes(fake, fake_rel, bounds), bounds)
        scores = _scores(d_config, d_params, fakes)
        ours = [np.asarray(part)[: b - a] for part, (a, b) in zip(scores, bounds)]
        compared["d_scores_fake"] = (np.concatenate(ours), theirs)
    return compared


@functools.partial(jax.jit, static_argnums=0)
def forecasts(
    config: GeneratorConfig,
    params: Any,
    scenes: Scene,
    noise: ArrayLike,
    alpha: ArrayLike | None = None,
) -> Array:
    """[S, N, pred_len, 2] displacements; one scene after another, so memory is that of one.

    `alpha` [S, ...] is what a NeuroSyM pooling takes for each scene.
    """
    generator = functools.partial(Generator(config).apply, {"params": params})
    return jax.lax.map(lambda given: generator(*given), (scenes, noise, alpha))


@functools.partial(jax.jit, static_argnums=0)
def _scores(config: DiscriminatorConfig, params: Any, scenes: Scene) -> Array:
    """[S, N] scores of whole trajectories, held by `scenes` as what was observed."""
    score = functools.partial(Discriminator(config).apply, {"params": params})
    return jax.lax.map(lambda s: score(s.observed, s.displacement, s.valid), scenes)


def make_scenes(traj: np.ndarray, traj_rel: np.ndarray, bounds: np.ndarray) -> list[Scene]:
    """The scenes of `traj [A, T, 2]`, moving by what was stored in `traj_rel`."""
    dtype = model_dtype()
    return [
        make_scene(traj[a:b]).replace(displacement=traj_rel[a:b].astype(dtype)) for a, b in bounds
    ]


def stacked(scenes: Sequence[Scene], bounds: np.ndarray) -> Scene:
    """The scenes padded to one size, so that a case is compiled once, with a leading axis [S]."""
    slots = int((bounds[:, 1] - bounds[:, 0]).max())
    padded = [pad_scene(scene.replace(identity=None, origin=None), slots) for scene in scenes]
    return jax.tree.map(lambda *parts: np.stack(parts), *padded)


def scene_noise(
    config: GeneratorConfig, arrays: Arrays, agents: int, bounds: np.ndarray
) -> np.ndarray:
    """[S, dim] where noise is global to a scene, else [S, slots, dim]; padding is zero."""
    if config.noise_dim == 0:
        return np.zeros((len(bounds), 0), model_dtype())
    if config.noise_mix_type == "global":
        return floats(arrays, "noise", len(bounds), config.noise_dim)
    noise = floats(arrays, "noise", agents, config.noise_dim)
    slots = int((bounds[:, 1] - bounds[:, 0]).max())
    return np.stack([np.pad(noise[a:b], [(0, slots - (b - a)), (0, 0)]) for a, b in bounds])


def scene_bounds(arrays: Arrays, agents: int) -> np.ndarray:
    """`scene_start_end [S, 2]`, once it cuts the agents into scenes without gap or overlap.

    Raises:
        InputError: where it is missing or does not.
    """
    name = "scene_start_end"
    if name not in arrays:
        raise InputError(f"the array {name!r} is missing")
    bounds = arrays[name]
    if bounds.ndim != 2 or bounds.shape[1] != 2 or not len(bounds) or bounds.dtype.kind not in "iu":
        raise InputError(f"{name!r} must be whole numbers [scenes, 2] of at least one scene")
    starts, ends = bounds.astype(np.int64).T
    follows = np.array_equal(starts, [0, *ends[:-1]]) and ends[-1] == agents
    if not follows or (ends <= starts).any():
        raise InputError(f"{name!r} does not cut {agents} agents into scenes one after another")
    return np.stack([starts, ends], axis=1)


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
    fields = {"pooling": named[pooling], "noise_dim": noise_dim}
    for name in (*SAME_NAME_ARGUMENTS, *RENAMED_ARGUMENTS):
        if name not in SOCIAL_ONLY or pooling == "spool":
            fields[name] = manifest_field(row, name)
    return from_json(GeneratorConfig, {"format": FORMAT, **fields}, "manifest")


def discriminator_config(row: Mapping[str, Any]) -> DiscriminatorConfig:
    """The discriminator of a row that has one."""
    fields = {
        "kind": manifest_field(row, "d_type"),
        "h_dim": manifest_field(row, "encoder_h_dim_d"),
    }
    fields |= {name: manifest_field(row, name) for name in ("embedding_dim", "mlp_dim")}
    return from_json(DiscriminatorConfig, {"format": FORMAT, **fields}, "manifest")


def manifest_field(row: Mapping[str, Any], name: str) -> Any:
    """What the row says of `name`.

    Raises:
        InputError: where it says nothing.
    """
    if name not in row:
        raise InputError(f"manifest: the row has no {name!r}")
    return row[name]
