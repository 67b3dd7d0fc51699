"""What a weighting is, as a value that is saved with the model, and the kinds there are by name.

The weights themselves are computed in `weighting`; tables and whatever else is learnt or estimated
lie with the model's parameters, not here.
"""

import dataclasses
import json
from collections.abc import Callable
from typing import Any, Literal

import jax.numpy as jnp

from neurosym_jax.configuration import (
    FORMAT,
    NotNegative,
    Positive,
    Whole,
    from_json,
    refuse_misfits,
)
from neurosym_jax.errors import InputError
from neurosym_jax.symbolic.built_in import WEIGHTINGS
from neurosym_jax.symbolic.qtc import Convention
from neurosym_jax.symbolic.weighting_kind import Parameters, Scenes, WeightingKind

__all__ = [
    "WEIGHTINGS",
    "Parameters",
    "Scenes",
    "WeightingConfig",
    "WeightingKind",
    "register_weighting",
]


@dataclasses.dataclass(frozen=True)
class WeightingConfig:
    """A weighting; equal weightings are equal, so that they share compiled programs."""

    kind: str = "cnd"
    """One of those in `weighting`, or of what `register_weighting` was told."""
    table: Literal["cnd", "cnd_shipped"] = "cnd"
    """The table of `quantised`, `soft` and `shuffled`, and where `learned` starts."""
    quantisation_factor: NotNegative | None = None
    """Metres a step; None is 0.05 for `quantised`, `soft` and `shuffled`, and 0 for the others."""
    side_quantisation_factor: NotNegative | None = None
    """See `qtc.qtc_c1`."""
    convention: Convention = "distance"
    """See `qtc`."""
    temperature: Positive = 0.02
    """Metres a step over which a soft symbol fades into the next, see `soft`."""
    decimals: Whole | None = None
    """To which a fixed table is rounded; the authors printed theirs with 4."""
    learned: bool | None = None
    """Whether training changes it; None means that only `learned` and one's own are."""

    def __post_init__(self):
        """Fill in what hangs on the kind; refuse what cannot be."""
        refuse_misfits(self)
        kind = WEIGHTINGS[self.kind]
        if self.quantisation_factor is None:
            object.__setattr__(self, "quantisation_factor", kind.quantisation_factor)
        if self.learned is None:
            object.__setattr__(self, "learned", kind.learned)
        if self.learned and not kind.learnable:
            raise InputError(f"the weighting {self.kind!r} has nothing to learn")
        if self.learned and kind.learns_quantisation and not self.quantisation_factor:
            raise InputError("a quantisation_factor of 0 cannot be learned: its logarithm is")

    @classmethod
    def from_text(cls, text: str, source: str = "weighting") -> "WeightingConfig":
        """The weighting of this `name`: `KIND[,FIELD=VALUE...]`.

        Raises:
            InputError: naming `source`, for an unknown kind or field, or a value that does not fit.
        """
        kind, *changes = text.split(",")
        fields: dict[str, Any] = {"format": FORMAT, "kind": kind}
        for change in changes:
            field, _, value = change.partition("=")
            try:
                fields[field] = json.loads(value)
            except json.JSONDecodeError:
                fields[field] = value
        return from_json(cls, fields, source)

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


def register_weighting(
    kind: str, *, replace: bool = False, **start: Any
) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    """Decorate a function `(positions [N, T, 2], valid [N], **parameters) -> alpha [N, N, T]`.

    It is then a weighting by the name `kind`. What an agent weighs for itself, in padding or alone
    is seen to.

    Args:
        kind: letters, digits and underscores.
        replace: take the place of another weighting of this name.
        **start: its learnable parameters, if any, and where they start.

    Raises:
        InputError: for a name that is taken or cannot be one.
    """

    def register(weigh: Callable[..., Any]) -> Callable[..., Any]:
        def weigh_scene(config, parameters, positions, valid):
            present = jnp.ones(len(positions), bool) if valid is None else jnp.asarray(valid)
            return weigh(positions, present, **parameters)

        learnable = bool(start)
        own = WeightingKind(
            weigh_scene, lambda config, scenes: start, learnable=learnable, learned=learnable
        )
        WEIGHTINGS.register(kind, own, replace=replace)
        return weigh

    return register
