"""Kinds of parity cases: outputs that torch stored, and ours of the same inputs.

A kind is a function of a manifest row and the case's arrays that returns `{output: (ours,
theirs)}`; `CASES` has them by name.
"""

from collections.abc import Callable, Mapping
from typing import Any

import jax
import numpy as np

from neurosym_jax.data.windows import Windows
from neurosym_jax.interop.case import Arrays, Compared, GeneratorCase, checked, placed
from neurosym_jax.interop.train_step import train_step
from neurosym_jax.models import NeurosymIjcnn
from neurosym_jax.symbolic.cnd import alpha_from_states
from neurosym_jax.symbolic.qtc import observe
from neurosym_jax.symbolic.state_weightings import CndShipped
from neurosym_jax.symbolic.weightings import make_weighting

__all__ = ["CASES", "compared_forecasts"]

DECIMALS = 4
"""Of the authors' table as they printed it, and of their coordinates."""
RELEASED = CndShipped(convention="as_published", decimals=DECIMALS)


def sgan(row: Mapping[str, Any], arrays: Arrays) -> Compared:
    """The generator's outputs and, where the row says `d_type`, the discriminator's scores.

    The discriminator sees torch's forecast, not ours, so that a fault of the generator is not
    reported twice.
    """
    case = GeneratorCase(row, arrays)
    compared = compared_forecasts(case)
    if "d_type" in row:
        theirs = checked(arrays, "d_scores_fake", case.windows.agents)
        forecasts = (compared[name][1] for name in ("pred_abs", "pred_rel"))
        compared["d_scores_fake"] = (case.scores(*forecasts), theirs)
    return compared


def compared_forecasts(case: GeneratorCase) -> Compared:
    """Forecasts of a network without symbols, as displacements and as positions.

    Raises:
        InputError: for an array that is missing or wrong.
    """
    outputs = (case.windows.agents, case.config.pred_len, 2)
    theirs = (checked(case.arrays, name, *outputs) for name in ("pred_rel", "pred_abs"))
    pred_rel, pred_abs = theirs
    ours, scenes = case.stages()["pred_rel"], case.scenes
    last = np.asarray(scenes.observed)[scenes.valid][:, -1:]
    origin = np.repeat(np.asarray(scenes.origin), case.windows.sizes, axis=0)[:, None]
    return {
        "pred_rel": (ours, pred_rel),
        "pred_abs": (last + np.cumsum(ours, axis=1) + origin, pred_abs),
    }


def neurosym(row: Mapping[str, Any], arrays: Arrays) -> Compared:
    """The forecast, given the stored alpha; and alpha itself, unless the row calls it random.

    NeuroSyM's first release stores a row of alpha for each ordered pair, N*N for a scene of N
    agents, but slices the rows by the agents' bounds. So a scene gets rows of other pairs, after
    the first scene those of other scenes, and its network reads row start + j for agent j, for
    every i: the A agents get the first A rows, which are compared as well.
    """
    case = GeneratorCase(row, arrays)
    windows, valid = case.windows, np.asarray(case.scenes.valid)
    alpha = checked(arrays, "alpha", int((windows.sizes**2).sum()), case.config.obs_len)
    compared: Compared = {}
    if row.get("alpha") != "random":
        compared["alpha"] = (_shipped_alpha(windows), alpha)
    if isinstance(case.config.pooling, NeurosymIjcnn):
        used = alpha[: windows.agents]
        theirs = checked(arrays, "alpha_rows_used", windows.agents, case.config.obs_len)
        compared["alpha_rows_used"] = (used, theirs)
        given = placed(used, valid)
    else:
        given = placed(alpha, valid[:, :, None] & valid[:, None])
    theirs = checked(arrays, "pred_rel", windows.agents, case.config.pred_len, 2)
    return compared | {"pred_rel": (case.stages(given)["pred_rel"], theirs)}


def qtc(_: Mapping[str, Any], arrays: Arrays) -> Compared:
    """States and weights of stored pairs, in every convention that is stored.

    Symbols are observed in float64 from the positions as stored, not centred: an exact tie, such as
    everybody on one line, is one in the coordinates that the released code saw. That code writes 10
    for a pair in which both people stand; we write 0.
    """
    k = checked(arrays, "k", None, None, 2).astype(np.float64)
    l = checked(arrays, "l", *k.shape).astype(np.float64)  # noqa: E741 (the calculus says so)
    steps = (len(k), k.shape[1] - 1)
    with jax.enable_x64(True):
        compiled = jax.jit(observe, static_argnames="convention")
        released = compiled(k, l, convention="as_published")
        ours = {
            "qtc_reference": released,
            "qtc_signed": compiled(k, l),
            "qtc_signed_q005": compiled(k, l, quantisation_factor=0.05),
        }
        weights = np.asarray(alpha_from_states(released, RELEASED.state_weights()))
    compared: Compared = {}
    for name, states in ours.items():
        theirs = checked(arrays, name, *steps, 4, kinds="iu")
        compared[name] = (np.asarray(states), np.where(theirs == 10, 0, theirs))
    return compared | {"alpha_reference": (weights, checked(arrays, "alpha_reference", *steps))}


CASES: dict[str, Callable[[Mapping[str, Any], Arrays], Compared]] = {
    "sgan": sgan,
    "neurosym_ros": neurosym,
    "neurosym_ijcnn": neurosym,
    "qtc": qtc,
    "train_step": train_step,
}


def _shipped_alpha(windows: Windows) -> np.ndarray:
    """[sum of N*N, T] by the authors' table; a scene of one agent has one row, of zeros."""
    # Stored as float32, but the released code observed its symbols in float64.
    positions = np.round(windows.position[:, : windows.obs_len], DECIMALS)
    weigh = jax.jit(make_weighting(RELEASED))
    with jax.enable_x64(True):
        scenes = [np.asarray(weigh(part)) for part in np.split(positions, windows.bounds[1:-1])]
    return np.concatenate([alpha.reshape(-1, alpha.shape[-1]) for alpha in scenes])
