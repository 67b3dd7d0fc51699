"""What a weighting is, as a value that is saved with the model, and the names there are.

The weights themselves are computed in `weighting`; tables and whatever else is learnt or estimated
lie with the model's parameters, not here.
"""

import dataclasses
import json
import math
from collections.abc import Callable
from typing import Any, Literal, NamedTuple, get_args

from neurosym_jax.errors import InputError
from neurosym_jax.symbolic.qtc import Convention

__all__ = ["KINDS", "WeightingConfig", "own_weighting", "register_weighting"]

KINDS = (
    *("cnd", "cnd_shipped", "quantised", "soft", "learned", "transition"),
    *("ones", "zeros", "shuffled"),
)
"""The weightings that are built in, see `weighting`."""

QUANTISED = ("quantised", "soft", "shuffled")
LEARNABLE = ("quantised", "soft", "learned", "transition")


class OwnWeighting(NamedTuple):
    """A weighting that is not built in."""

    weigh: Callable[..., Any]
    """`(positions [N, T, 2], valid [N], **parameters) -> alpha [N, N, T]`."""
    start: dict[str, Any]
    """What its parameters are before training."""


_OWN: dict[str, OwnWeighting] = {}


def register_weighting(kind: str, **start: Any) -> Callable[[Callable], Callable]:
    """Decorate a function `(positions [N, T, 2], valid [N], **parameters) -> alpha [N, N, T]`.

    It is then a weighting by the name `kind`. `start` names its learnable parameters, if any, and
    says where they start. What an agent weighs for itself, in padding or alone is seen to.

    Raises:
        InputError: for a name that is built in or cannot be written in a list of names.
    """
    if kind in KINDS or not kind.isidentifier():
        raise InputError(f"{kind!r} cannot name a weighting of one's own")

    def register(weigh: Callable) -> Callable:
        _OWN[kind] = OwnWeighting(weigh, start)
        return weigh

    return register


def own_weighting(kind: str) -> OwnWeighting:
    """What was registered by this name."""
    return _OWN[kind]


@dataclasses.dataclass(frozen=True)
class WeightingConfig:
    """A weighting; equal weightings are equal, so that they share compiled programs."""

    kind: str = "cnd"
    """One of `KINDS`, or of what `register_weighting` was told."""
    table: Literal["cnd", "cnd_shipped"] = "cnd"
    """The table of `quantised`, `soft` and `shuffled`, and where `learned` starts."""
    quantisation_factor: float | None = None
    """Metres a step; None is 0.05 for `quantised`, `soft` and `shuffled`, and 0 for the others."""
    side_quantisation_factor: float | None = None
    """See `qtc.qtc_c1`."""
    convention: Convention = "distance"
    """See `qtc`."""
    temperature: float = 0.02
    """Metres a step over which a soft symbol fades into the next, see `soft`."""
    decimals: int | None = None
    """To which a fixed table is rounded; the authors printed theirs with 4."""
    learned: bool | None = None
    """Whether training changes it; None means that only `learned` is."""

    def __post_init__(self):
        """Fill in what hangs on the kind; refuse what cannot be."""
        if self.kind not in KINDS and self.kind not in _OWN:
            raise InputError(
                f"unknown weighting {self.kind!r}: there are {', '.join((*KINDS, *_OWN))} "
                "(one's own has to be imported first)"
            )
        if self.quantisation_factor is None:
            factor = 0.05 if self.kind in QUANTISED else 0.0
            object.__setattr__(self, "quantisation_factor", factor)
        if self.learned is None:
            own = self.kind in _OWN and bool(_OWN[self.kind].start)
            object.__setattr__(self, "learned", self.kind == "learned" or own)
        if self.learned and self.kind in KINDS and self.kind not in LEARNABLE:
            raise InputError(f"the weighting {self.kind!r} has nothing to learn")
        for name in ("quantisation_factor", "side_quantisation_factor"):
            value = getattr(self, name)
            if value is not None and not 0 <= value < math.inf:
                raise InputError(f"{name} must be at least 0, not {value}")
        if not 0 < self.temperature < math.inf:
            raise InputError(f"temperature must be positive, not {self.temperature}")
        if self.convention not in get_args(Convention):
            known = ", ".join(get_args(Convention))
            raise InputError(f"unknown QTC convention {self.convention!r}: there are {known}")
        if self.learned and self.kind in ("quantised", "soft") and not self.quantisation_factor:
            raise InputError("a quantisation_factor of 0 cannot be learned: its logarithm is")

    @property
    def name(self) -> str:
        """The kind and what differs from its defaults: `soft,temperature=0.1`."""
        usual = dataclasses.asdict(WeightingConfig(self.kind))
        changed = [
            f"{name}={value if isinstance(value, str) else json.dumps(value)}"
            for name, value in dataclasses.asdict(self).items()
            if value != usual[name]
        ]
        return ",".join([self.kind, *changed])
