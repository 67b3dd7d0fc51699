"""The symbols, weights and events of pairs that the page shows beside a model in JAX."""

from collections.abc import Mapping
from typing import Any

import jax
import numpy as np

from neurosym_jax.data.windows import bucket_of
from neurosym_jax.runtime.programs import program
from neurosym_jax.scene import make_scene, pad_scene
from neurosym_jax.symbolic.events import EVENTS
from neurosym_jax.symbolic.weighting import Cnd, Parameters, Weighting


@program((0, 4))
def newest_symbols(
    weighting: Weighting,
    parameters: Parameters,
    positions: jax.Array,
    valid: jax.Array,
    period: float,
) -> tuple[jax.Array, jax.Array]:
    """The newest state of every pair of people, and its weight, from `positions` [N, T, 2].

    [N, N] codes as of `states.encode_state`, (i, j) with i as k and j as l; and [N, N]
    alpha. Where `valid` [N] is False there is nobody.
    """
    codes = weighting.codes(parameters, positions[:, -2:], period=period)
    alpha = weighting.alpha(parameters, positions, valid, period=period)
    return codes[:, :, -1], alpha[:, :, -1]


class PairSymbols:
    """Symbols by the convention of the first NeuroSyM; without one, by that of the papers."""

    def __init__(self, models: Mapping[str, Any], period: float):
        """Of models by name, and steps of `period` seconds."""
        weighted = [name for name, model in models.items() if model.weighting]
        self.model = (weighted or [*models])[0]
        """The model whose weights and events are shown."""
        chosen = models[self.model]
        self._weighting = chosen.weighting or Cnd()
        self._parameters = chosen.params.get("weighting", {})
        self._period = period
        self.weighting: dict[str, str] | None = None
        """The model with weights, and their name."""
        if weighted:
            self.weighting = {"model": self.model, "name": self._weighting.name}

    @property
    def words(self) -> dict[str, str]:
        """Each event in short, with `{k}` and `{l}` in place of the two."""
        return {name: event.in_short(name) for name, event in EVENTS.items()}

    def newest(self, observed: np.ndarray) -> tuple[np.ndarray, np.ndarray | None]:
        """`newest_symbols` of people `observed` [N, T, 2]; no alpha where no model has any."""
        people = len(observed)
        scene = pad_scene(make_scene(observed), int(bucket_of(people)))
        arrays = scene.observed, scene.valid
        newest = newest_symbols(
            self._weighting, self._parameters, *arrays, self._period
        )
        codes, alpha = (np.asarray(values)[:people, :people] for values in newest)
        return codes, alpha if self.weighting else None
