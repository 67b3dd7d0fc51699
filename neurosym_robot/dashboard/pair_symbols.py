"""The QTC symbols of every pair as a forecast's model sees them, and the weight it gives them."""

import functools
from collections.abc import Mapping

import jax
import numpy as np

from neurosym_jax.data.batching import bucket_of
from neurosym_jax.forecasting.model import Model
from neurosym_jax.scene import make_scene, pad_scene
from neurosym_jax.symbolic.state_weightings import Cnd
from neurosym_jax.symbolic.weighting import Parameters, Weighting

__all__ = ["PairSymbols"]


class PairSymbols:
    """Symbols by the convention of the first NeuroSyM among some models; else the papers'."""

    def __init__(self, models: Mapping[str, Model]):
        symbolic = {name: each for name, each in models.items() if each.weighting}
        self.model = next(iter(symbolic), None)
        """Its name, None where no model weights pairs."""
        self.weighting: Weighting = Cnd()
        self._parameters: Parameters = {}
        if self.model is not None:
            chosen = symbolic[self.model]
            self.weighting = chosen.weighting or self.weighting
            self._parameters = chosen.params.get("weighting", {})

    def __call__(self, observed: np.ndarray) -> tuple[np.ndarray, np.ndarray | None]:
        """The newest state of every pair, and the weights of the newest step.

        Args:
            observed: [N, obs_len, 2] metres.

        Returns:
            [N, N] codes as of `states.encode_state`, (i, j) with i as k and j as l; and [N, N]
            alpha, None where no model weights pairs.
        """
        people = len(observed)
        scene = pad_scene(make_scene(observed), int(bucket_of(people)))
        codes, alpha = _newest(self.weighting, self._parameters, scene.observed, scene.valid)
        weights = None if self.model is None else np.asarray(alpha)[:people, :people]
        return np.asarray(codes)[:people, :people], weights


@functools.partial(jax.jit, static_argnums=0)
def _newest(
    weighting: Weighting, parameters: Parameters, positions: jax.Array, valid: jax.Array
) -> tuple[jax.Array, jax.Array]:
    codes = weighting.codes(parameters, positions[:, -2:])
    return codes[:, :, -1], weighting.alpha(parameters, positions, valid)[:, :, -1]
