"""Parity of networks: a case's weights through our conversion, its inputs through our networks."""

import functools
from collections.abc import Mapping
from typing import Any

import jax
import numpy as np
from jax import Array
from jax.typing import ArrayLike

from neurosym_jax.data.windows import Windows
from neurosym_jax.errors import InputError
from neurosym_jax.interop.arguments import discriminator_config
from neurosym_jax.interop.names import params_from_torch
from neurosym_jax.interop.parity_case import (
    Arrays,
    Compared,
    case_scenes,
    floats,
    generator_of,
    placed,
    scenes_of,
    state_dict,
)
from neurosym_jax.interop.parity_symbols import shipped_alpha
from neurosym_jax.models import Discriminator, Generator, NeurosymIjcnn
from neurosym_jax.models.config import DiscriminatorConfig, GeneratorConfig
from neurosym_jax.scene import Scene, model_dtype

__all__ = ["alpha_rows_used", "neurosym", "sgan"]


def sgan(row: Mapping[str, Any], arrays: Arrays) -> Compared:
    """The generator's outputs and, where the row says `d_type`, the discriminator's scores.

    The discriminator sees torch's forecast, not ours, so that a fault of the generator is not
    reported twice.
    """
    config = generator_of(row)
    windows, scenes = case_scenes(config, arrays)
    outputs = (windows.agents, config.pred_len, 2)
    pred_rel, pred_abs = (floats(arrays, name, *outputs) for name in ("pred_rel", "pred_abs"))
    ours = _forecast(config, arrays, scenes)
    last = np.asarray(scenes.observed)[scenes.valid][:, -1:]
    origin = np.repeat(np.asarray(scenes.origin), windows.sizes, axis=0)[:, None]
    compared = {
        "pred_rel": (ours, pred_rel),
        "pred_abs": (last + np.cumsum(ours, axis=1) + origin, pred_abs),
    }
    if "d_type" in row:
        d_config = discriminator_config(row, "manifest")
        d_params = params_from_torch(state_dict(arrays, "d_state/"), d_config)
        theirs = floats(arrays, "d_scores_fake", windows.agents)
        observed = windows.position[:, : config.obs_len]
        whole = np.concatenate([observed, pred_abs.astype(np.float64)], axis=1)
        moves = np.concatenate([arrays["traj_rel"][:, : config.obs_len], pred_rel], axis=1)
        fakes = scenes_of(
            Windows(whole, windows.agent, windows.bounds, windows.identity, whole.shape[1]), moves
        )
        scores = np.asarray(_scores(d_config, d_params, fakes.bare()))
        compared["d_scores_fake"] = (scores[fakes.valid], theirs)
    return compared


def neurosym(row: Mapping[str, Any], arrays: Arrays) -> Compared:
    """The forecast, given the stored alpha; and alpha itself, unless the row calls it random.

    Of the earlier release also the rows of alpha that its collation picks.
    """
    config = generator_of(row)
    windows, scenes = case_scenes(config, arrays)
    alpha = floats(arrays, "alpha", int((windows.sizes**2).sum()), config.obs_len)
    compared: Compared = {}
    if row.get("alpha") != "random":
        compared["alpha"] = (shipped_alpha(windows), alpha)
    valid = np.asarray(scenes.valid)
    if isinstance(config.pooling, NeurosymIjcnn):
        # Alpha by agents: what the network of the earlier release takes.
        bounds = np.stack([windows.bounds[:-1], windows.bounds[1:]], axis=1)
        used = np.concatenate(alpha_rows_used(alpha, bounds))
        theirs = floats(arrays, "alpha_rows_used", windows.agents, config.obs_len)
        compared["alpha_rows_used"] = (used, theirs)
        given = placed(used, valid)
    else:
        given = placed(alpha, valid[:, :, None] & valid[:, None])
    theirs = floats(arrays, "pred_rel", windows.agents, config.pred_len, 2)
    return compared | {"pred_rel": (_forecast(config, arrays, scenes, given), theirs)}


def _forecast(
    config: GeneratorConfig, arrays: Arrays, scenes: Scene, alpha: ArrayLike | None = None
) -> np.ndarray:
    """[A, pred_len, 2] displacements of the case's agents by its own weights and noise."""
    params = params_from_torch(state_dict(arrays, "g_state/"), config)
    valid = np.asarray(scenes.valid)
    if config.noise_dim == 0:
        noise = np.zeros((len(valid), 0), model_dtype())
    elif config.noise_mix_type == "global":
        noise = floats(arrays, "noise", len(valid), config.noise_dim)
    else:
        noise = placed(floats(arrays, "noise", valid.sum(), config.noise_dim), valid)
    return np.asarray(_forecasts(config, params, scenes.bare(), noise, alpha))[valid]


@functools.partial(jax.jit, static_argnums=0)
def _forecasts(config: GeneratorConfig, params: Any, *given: Any) -> Array:
    """[S, N, pred_len, 2] displacements; one scene after another, so memory is that of one."""
    generator = functools.partial(Generator(config).apply, {"params": params})
    return jax.lax.map(lambda of_scene: generator(*of_scene), given)


@functools.partial(jax.jit, static_argnums=0)
def _scores(config: DiscriminatorConfig, params: Any, scenes: Scene) -> Array:
    """[S, N] scores of whole trajectories, held by `scenes` as what was observed."""
    score = functools.partial(Discriminator(config).apply, {"params": params})
    return jax.lax.map(lambda s: score(s.observed, s.displacement, s.valid), scenes)


def alpha_rows_used(pair_rows: np.ndarray, bounds: np.ndarray) -> list[np.ndarray]:
    """The rows of alpha [N, T] that NeuroSyM's first release multiplies the agents of a scene by.

    The release stores a row for each ordered pair, N*N for a scene of N agents, but slices the rows
    by the agents' bounds, N for a scene. So a scene gets rows of other pairs, after the first scene
    those of other scenes, and its network reads row start + j for agent j, for every i.

    Args:
        pair_rows: [sum of N*N, T] weights of the pairs of all scenes, pair (i, j) of a scene in
            its row i*N + j; a scene of one agent has one row.
        bounds: [S, 2] first and one past the last agent of each scene, counted over all scenes.

    Raises:
        InputError: where there are not as many rows as pairs.
    """
    pairs = int(((bounds[:, 1] - bounds[:, 0]) ** 2).sum())
    if len(pair_rows) != pairs:
        raise InputError(f"'alpha' has {len(pair_rows)} rows for {pairs} pairs")
    return [pair_rows[start:end] for start, end in bounds]
