"""What a pooling is; `poolings` has the table."""

import dataclasses
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from neurosym_jax.config import GeneratorConfig

__all__ = ["NOT_OF_PAIRS", "Pooling"]

NOT_OF_PAIRS = (
    "does not weight pairs: it takes one row of alpha an agent, picked by the released collation "
    "out of other scenes' pairs, so it forecasts in parity cases only"
)
"""After the name of a pooling that is not `of_pairs`."""


@dataclasses.dataclass(frozen=True)
class Pooling:
    """A pooling over the neighbours in one scene, `[N, H]` hidden states to `[N, B]` vectors.

    Its module is called with `(hidden [N, H], positions [N, 2], valid [N])`. It gives a finite
    vector for every slot, and lets only agents contribute that are valid. B is the configuration's
    `bottleneck_dim`.
    """

    module: Callable[["GeneratorConfig", int], Any] | None
    """Flax module of `(config, h_dim)`, H being `h_dim`; None where there is nothing to pool."""
    label: str
    """What a model with it is called in tables."""
    symbolic: bool = False
    """Takes `(hidden, observed [N, obs_len, 2], valid, alpha [N, N, obs_len])`: NeuroSyM."""
    whole_observation: bool = False
    """Takes `(hidden, observed [N, obs_len, 2], valid)`, without alpha."""
    returns_hidden: bool = False
    """B is H, so that `bottleneck_dim` must equal it."""
    of_pairs: bool = True
    """Of symbolic ones: False where alpha is `[N, obs_len]`, see `NOT_OF_PAIRS`."""
    pair_numbers: Callable[["GeneratorConfig"], float] = lambda _: 0.0
    """About how many numbers one call keeps for each pair of slots, for the size of batches."""

    @property
    def windowed(self) -> bool:
        """Whether it sees the last `obs_len` positions, at predicted steps too, not only the last.

        At a predicted step they are those seen or predicted before it and at it.
        """
        return self.symbolic or self.whole_observation
