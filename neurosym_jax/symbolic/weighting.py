"""Weights of the interaction of two agents: `(positions [N, T, 2], valid [N]) -> alpha [N, N, T]`.

NeuroSyM (Mghames et al., 2023) multiplies what the pooling knows of a pair by alpha, looked up by
the QTC_C1 state that the pair was last observed in. Which weighting is a value, `WeightingConfig`;
`scene_alpha` is the one place where a scene's alpha is computed, `make_weighting` the same as a
function of one's own to call. The kinds:

- `cnd`: 1 / N_Tr, N_Tr the neighbours of the state in the conceptual neighbourhood diagram of the
  theory. What the papers describe.
- `cnd_shipped`: the authors' own table, 1 / (2^nonzero 3^zero), which counts neighbours by
  continuity alone and staying as one of them; 4 decimals give it as they printed it.
- `quantised`: `cnd` of symbols that are 0 below 5 cm a step; the threshold may be learnt, by
  straight-through gradients.
- `soft`: what `cnd` is expected to be where symbols fade into each other, see `soft`.
- `learned`: 81 free weights, one a state, and one for the first step; they start at the table.
- `transition`: P(q_t | q_(t-1)), how often people in the state before came into this one, counted
  in the training data; at the first state P(q_t).
- `ones`: nothing is weighted, at any step, observed or not: the neural part alone.
- `zeros`: no weight for anyone but oneself. What the released training was fed with the authors'
  table, because its reader took the first character of a label such as `0.0625`.
- `shuffled`: the weights of `quantised` with the wrong pairs. Each neighbour of an agent gets those
  of the next nearer one, the nearest those of the farthest, and the last step first. A control: the
  same weights in the same scene, saying nothing.

This is neither how each of them is computed (see `built_in`) nor the pooling that uses the weights
(see `models.symbolic_pooling`).
"""

from collections.abc import Callable
from typing import Any

import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import ArrayLike

from neurosym_jax.symbolic.qtc import pair_mask
from neurosym_jax.symbolic.weighting_config import (
    WEIGHTINGS,
    Parameters,
    Scenes,
    WeightingConfig,
)

__all__ = ["Weighting", "initial_parameters", "make_weighting", "scene_alpha"]

Weighting = Callable[..., Array]
"""`(positions [N, T, 2] metres, valid [N] or None) -> alpha [N, N, T]`."""


def make_weighting(
    config: WeightingConfig | str = "cnd", parameters: Parameters | None = None
) -> Weighting:
    """The weighting as a function of a scene.

    Args:
        config: a value, or text as `WeightingConfig.name` gives it: `soft,temperature=0.05`.
        parameters: what it has learned; by default, where it starts.

    Raises:
        InputError: for an unknown kind or setting.
    """
    chosen = WeightingConfig.from_text(config) if isinstance(config, str) else config
    given = initial_parameters(chosen) if parameters is None else parameters

    def weigh(positions: ArrayLike, valid: ArrayLike | None = None) -> Array:
        return scene_alpha(chosen, given, positions, valid)

    return weigh


def initial_parameters(
    config: WeightingConfig | None, scenes: Scenes | None = None
) -> dict[str, Any]:
    """What the weighting has to learn or to estimate, float32; empty where there is nothing.

    Args:
        config: the weighting, None for a model without.
        scenes: the training data; `transition` is estimated from it, and without it knows nothing.
    """
    start = {} if config is None else WEIGHTINGS[config.kind].start(config, scenes)
    return {name: np.asarray(value, np.float32) for name, value in start.items()}


def scene_alpha(
    config: WeightingConfig,
    parameters: Parameters,
    positions: ArrayLike,
    valid: ArrayLike | None = None,
) -> Array:
    """Weights of the interactions of every ordered pair of one scene.

    The state observed from t-1 to t weights the interaction at t, so t = 0 has no state and weighs
    0 (with `ones`: 1). An agent with itself weighs 1 at every step, whatever the weighting. Pairs
    with an agent that is not valid weigh 0. So does everything in a scene of exactly one valid
    agent, who interacts with nobody: this is told from `valid`, not from the padded size.

    Args:
        config: the weighting.
        parameters: as `initial_parameters(config)`, or what they were learnt to be.
        positions: [N, T, 2] metres, T >= 1.
        valid: [N] bool, False for padding; None for no padding.

    Returns:
        [N, N, T] weights in the floating type of `positions`; (i, j) is how much j matters to i.
    """
    positions = jnp.asarray(positions, jnp.result_type(positions, 0.0))
    count = len(positions)
    alpha = WEIGHTINGS[config.kind].weigh(config, parameters, positions, valid)
    alpha = jnp.where(jnp.eye(count, dtype=bool)[..., None], 1, alpha.astype(positions.dtype))
    pairs = pair_mask(valid, count)
    return jnp.where((pairs & (pairs.sum() != 1))[..., None], alpha, 0)
