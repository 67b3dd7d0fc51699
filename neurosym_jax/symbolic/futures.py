"""States and events in sampled futures, sample by sample.

Thresholds are in metres per second, so that they mean the same at every period.
"""

import dataclasses
from typing import Any

import jax.numpy as jnp
from jax import Array

from neurosym_jax.configuration import Checked, NotNegative, Positive
from neurosym_jax.errors import InputError
from neurosym_jax.symbolic.calculi import CALCULI, observe, state_index
from neurosym_jax.symbolic.events import Encounter, events_named

__all__ = ["SymbolSettings", "event_steps", "state_steps"]


@dataclasses.dataclass(frozen=True)
class SymbolSettings(Checked):
    """Period, thresholds and the smoothing of probabilities."""

    period: Positive = 0.4
    """Seconds between steps."""
    calculus: str = "c1"
    """Calculus of the states; events are of QTC_C1."""
    speed: NotNegative = 0.125
    """Metres per second up to which a movement towards, away or to a side counts as none."""
    smoothing: NotNegative = 1.0
    """Weight of the prior in samples, see `forecast`; 0 leaves shares as they are counted."""

    def __post_init__(self):
        """Refuse an unknown calculus."""
        super().__post_init__()
        CALCULI[self.calculus]

    @property
    def thresholds(self) -> dict[str, Any]:
        """Arguments of `calculi.observe`, in metres per step."""
        step = self.speed * self.period
        return {"quantisation_factor": step, "side_quantisation_factor": step}


def state_steps(settings: SymbolSettings, k: Array, l: Array) -> Array:
    """[..., T] rows of the pairs' states among those of the calculus.

    Args:
        settings: calculus and thresholds.
        k: [..., T + 1, 2] metres, the last position observed first.
        l: the same; leading axes broadcast against those of `k`.
    """
    return state_index(settings.calculus, observe(k, l, settings.calculus, **settings.thresholds))


def event_steps(settings: SymbolSettings, names: tuple[str, ...], k: Array, l: Array) -> Array:
    """The step at which each of E events first happens to pairs, see `state_steps`.

    Returns:
        [E, ...] int32 steps from 0; T where it does not happen.

    Raises:
        InputError: for an unknown event, or one that returns another shape or type than `Event`
            says.
    """
    states = observe(k, l, **settings.thresholds)
    k, l = jnp.broadcast_arrays(k, l)
    encounter = Encounter(states, k, l, settings.period, settings.speed)
    steps = states.shape[-2]
    first = []
    for name, event in events_named(names).items():
        happens = event.happens(encounter)
        if happens.shape != states.shape[:-1] or happens.dtype != bool:
            raise InputError(
                f"event {name}: bool [..., {steps}] is wanted, not {happens.dtype} "
                f"{list(happens.shape)}"
            )
        first.append(jnp.where(happens.any(axis=-1), happens.argmax(axis=-1), steps))
    return jnp.stack(first).astype(jnp.int32)
