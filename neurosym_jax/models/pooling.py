"""What a pooling is; `poolings` has the table."""

import abc
import dataclasses
from typing import Any, ClassVar

from neurosym_jax.configuration import Checked

__all__ = ["NO_FORECAST", "Pooling"]

NO_FORECAST = (
    "does not weight pairs: it takes one row of alpha an agent, picked by the released collation "
    "out of other scenes' pairs, so it forecasts in parity cases only"
)
"""What is wrong with a pooling that takes "alpha_rows"."""


@dataclasses.dataclass(frozen=True)
class Pooling(Checked, abc.ABC):
    """A pooling over each agent's neighbours in one scene; the fields of a subclass are options.

    A subclass is registered by `register_pooling` and chosen by `GeneratorConfig.pooling`.
    """

    title: ClassVar[str]
    """What a model with it is called in tables."""
    inputs: ClassVar[frozenset[str]] = frozenset({"hidden", "position"})
    """What the network is called with, by name, besides `valid` [N] bool:

    - "hidden": [N, h_dim] hidden states;
    - "position": [N, 2] metres, the last position;
    - "track": [N, obs_len, 2] metres, the last positions, observed or predicted;
    - "alpha": [N, N, obs_len] weight of j for i at each step of the track;
    - "alpha_rows": [N, obs_len] instead, for the parity of a release (`NO_FORECAST`).
    """

    @abc.abstractmethod
    def network(self, h_dim: int, *, obs_len: int, embedding_dim: int) -> Any:
        """The Flax module from `inputs` to [N, `width(h_dim)`].

        It returns finite vectors for every slot; only valid agents contribute. Sizes are those of
        a hidden state, a track, and an embedded position in the generator.
        """

    def width(self, h_dim: int) -> int:
        """Size of a pooled vector, by default the option `bottleneck_dim`."""
        return getattr(self, "bottleneck_dim")  # noqa: B009 (a subclass has it)
