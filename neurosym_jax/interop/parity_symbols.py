"""Parity of NeuroSyM: its two released networks, their weights alpha, and QTC arrays.

Symbols are observed in float64 from the positions as stored, not centred: an exact tie, such as
everybody on one line, is one in the coordinates that the released code saw.
"""

from collections.abc import Mapping
from typing import Any

import jax
import numpy as np

from neurosym_jax.errors import InputError
from neurosym_jax.interop.collation import alpha_rows_used
from neurosym_jax.interop.names import generator_params_from_torch
from neurosym_jax.interop.parity_networks import (
    Arrays,
    Compared,
    floats,
    forecasts,
    generator_config,
    make_scenes,
    scene_bounds,
    scene_noise,
    stacked,
    state_dict,
)
from neurosym_jax.symbolic.built_in import alpha_from_states, table_of
from neurosym_jax.symbolic.qtc import qtc_c1
from neurosym_jax.symbolic.weighting import make_weighting
from neurosym_jax.symbolic.weighting_config import WeightingConfig

__all__ = ["neurosym", "qtc"]

DECIMALS = 4
"""Of the authors' table as they printed it, and of their coordinates."""

RELEASED = WeightingConfig("cnd_shipped", convention="as_published", decimals=DECIMALS)


def neurosym(row: Mapping[str, Any], arrays: Arrays) -> Compared:
    """The forecast, given the stored alpha; and alpha itself, unless the row calls it random.

    Of the earlier release also the rows of alpha that its collation picks.
    """
    config = generator_config(row)
    params = generator_params_from_torch(state_dict(arrays, "g_state/"), config)
    traj = floats(arrays, "traj", None, config.obs_len + config.pred_len, 2)
    agents, steps, _ = traj.shape
    traj_rel = floats(arrays, "traj_rel", agents, steps, 2)
    bounds = scene_bounds(arrays, agents)
    sizes = bounds[:, 1] - bounds[:, 0]
    pairs = int((sizes**2).sum())
    alpha = floats(arrays, "alpha", pairs, config.obs_len)
    observed = traj[:, : config.obs_len]
    compared: Compared = {}
    if row.get("alpha") != "random":
        compared["alpha"] = (_shipped_alpha(observed, bounds), alpha)
    if config.pooling == "neurosym_ijcnn":
        # Alpha by agents: what the network of the earlier release takes.
        given = alpha_rows_used(alpha, bounds)
        theirs = floats(arrays, "alpha_rows_used", agents, config.obs_len)
        compared["alpha_rows_used"] = (np.concatenate(given), theirs)
    else:
        ends = np.cumsum(sizes**2)
        given = [rows.reshape(n, n, -1) for n, rows in zip(sizes, np.split(alpha, ends[:-1]))]
    slots = int(sizes.max())
    padded = np.stack(
        [
            np.pad(part, [(0, slots - n)] * (part.ndim - 1) + [(0, 0)])
            for n, part in zip(sizes, given)
        ]
    )
    pred_rel = floats(arrays, "pred_rel", agents, config.pred_len, 2)
    scenes = stacked(make_scenes(observed, traj_rel[:, : config.obs_len], bounds), bounds)
    noise = scene_noise(config, arrays, agents, bounds)
    ours = forecasts(config, params, scenes, noise, padded)
    parts = [np.asarray(part)[:n] for n, part in zip(sizes, ours)]
    compared["pred_rel"] = (np.concatenate(parts), pred_rel)
    return compared


def qtc(row: Mapping[str, Any], arrays: Arrays) -> Compared:
    """States and weights of stored pairs, in every convention that is stored.

    The released code writes 10 for a pair of which nobody moves; we write 0 as for any standing.
    """
    del row
    k = floats(arrays, "k", None, None, 2)
    pairs, steps, _ = k.shape
    k, l = (  # noqa: E741 (the calculus calls the two points k and l)
        floats(arrays, name, pairs, steps, 2).astype(np.float64) for name in ("k", "l")
    )
    with jax.enable_x64(True):
        observe = jax.jit(qtc_c1, static_argnames="convention")
        released = observe(k, l, convention="as_published")
        ours = {
            "qtc_reference": released,
            "qtc_signed": observe(k, l),
            "qtc_signed_q005": observe(k, l, quantisation_factor=0.05),
        }
        weights = np.asarray(alpha_from_states(released, table_of(RELEASED)))
    compared: Compared = {}
    for name, states in ours.items():
        theirs = _symbols(arrays, name, (pairs, steps - 1, 4))
        compared[name] = (np.asarray(states), np.where(theirs == 10, 0, theirs))
    compared["alpha_reference"] = (weights, floats(arrays, "alpha_reference", pairs, steps - 1))
    return compared


def _shipped_alpha(observed: np.ndarray, bounds: np.ndarray) -> np.ndarray:
    """[sum of N*N, T] by the authors' table; a scene of one agent has one row, of zeros."""
    # Stored as float32, but the released code observed its symbols in float64.
    positions = np.round(observed.astype(np.float64), DECIMALS)
    weigh = jax.jit(make_weighting(RELEASED))
    with jax.enable_x64(True):
        scenes = [np.asarray(weigh(positions[a:b])) for a, b in bounds]
    return np.concatenate([alpha.reshape(-1, alpha.shape[-1]) for alpha in scenes])


def _symbols(arrays: Arrays, name: str, shape: tuple[int, ...]) -> np.ndarray:
    if name not in arrays:
        raise InputError(f"the array {name!r} is missing")
    if arrays[name].shape != shape or arrays[name].dtype.kind not in "iu":
        raise InputError(f"{name!r} must be whole numbers of the shape {list(shape)}")
    return arrays[name]
