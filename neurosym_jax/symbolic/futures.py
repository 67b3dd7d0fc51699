"""Sampled futures of pairs: their states and events, sample by sample.

Thresholds are in metres and metres per second, so that they mean the same at every period. The
first step leads from the last position observed.
"""

import dataclasses
import math
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import ArrayLike

from neurosym_jax.configuration import Checked, NotNegative, Positive
from neurosym_jax.errors import InputError
from neurosym_jax.symbolic.calculi import CALCULI, observe, state_index
from neurosym_jax.symbolic.events import Encounter, events_named
from neurosym_jax.symbolic.qtc import Convention, other_pairs

__all__ = ["Futures", "SymbolSettings", "event_steps", "pair_states_of"]


@dataclasses.dataclass(frozen=True)
class SymbolSettings(Checked):
    """Thresholds of movements, and the smoothing of probabilities."""

    period: Positive = 0.4
    """Seconds between steps."""
    calculus: str = "c1"
    """Calculus of the states; events are of QTC_C1."""
    convention: Convention = "distance"
    """Definition of the symbols, see `qtc`."""
    speed: NotNegative = 0.125
    """Metres per second up to which a movement towards, away or to a side counts as none."""
    angle: NotNegative = 0.0
    """Degrees up to which two angles are equal, for the symbol q6."""
    near: NotNegative = 1.22
    """Metres up to which a pair of QTC_BC has sides."""
    apart: NotNegative | None = None
    """Metres beyond which a pair of QTC_BC has no sides; None is `near`."""
    smoothing: NotNegative = 1.0
    """Weight of the prior in samples, see `forecast`; 0 leaves shares as they are counted."""

    def __post_init__(self):
        """Refuse an unknown calculus."""
        super().__post_init__()
        CALCULI[self.calculus]

    @property
    def thresholds(self) -> dict[str, Any]:
        """Arguments of `calculi.observe`, in metres per step and radians."""
        step = self.speed * self.period
        return {
            "convention": self.convention,
            "quantisation_factor": step,
            "side_quantisation_factor": step,
            "angle": math.radians(self.angle),
            "near": self.near,
            "apart": self.apart,
        }


class Futures(NamedTuple):
    """Sampled futures of N people, and the pairs of them that are looked at."""

    samples: Array
    """[k, N, T, 2] metres."""
    last: Array
    """[N, 2] metres, the last positions observed."""
    pairs: Array | None = None
    """[P, 2] ordered pairs (k, l) of agents; None for all, [N, N]."""

    @classmethod
    def of(cls, samples: ArrayLike, observed: ArrayLike, pairs: ArrayLike | None) -> "Futures":
        """Check `samples [k, N, T, 2]` and `observed [N, obs_len, 2]`, in metres, and centre them.

        Raises:
            InputError: for shapes that do not fit, or a pair of an agent that does not exist.
        """
        shape, seen = np.shape(samples), np.shape(observed)
        if len(shape) != 4 or len(seen) != 3 or shape[3] != 2 or not all((*shape, *seen)):
            raise InputError(
                "samples must be [k, N, T, 2] and observed [N, obs_len, 2], not "
                f"{list(shape)} and {list(seen)}"
            )
        if shape[1] != seen[0] or seen[2] != 2:
            raise InputError(f"samples are of {shape[1]} people, observed of {seen[0]}")
        given: Any = samples
        last: Any = observed
        last = (last if isinstance(last, jax.Array) else np.asarray(last))[:, -1]
        if isinstance(last, np.ndarray):
            # Far from the origin float32 would lose the differences.
            origin = last.astype(np.float64).mean(axis=0)
            given, last = given - origin, last - origin
        if pairs is not None:
            if isinstance(pairs, np.ndarray | list) and not np.isin(pairs, range(seen[0])).all():
                raise InputError(f"pairs must name people by 0 to {seen[0] - 1}")
            pairs = jnp.asarray(pairs, int).reshape(-1, 2)
        return cls(jnp.asarray(given, float), jnp.asarray(last, float), pairs)

    def others(self, valid: ArrayLike | None) -> Array:
        """[P] or [N, N] bool: pairs of two different people, both `valid [N]`."""
        others = other_pairs(valid, len(self.last))
        return others if self.pairs is None else others[tuple(self.pairs.T)]

    def ends(self) -> tuple[Array, Array]:
        """Positions of k and of l from the last observed on.

        Each [k, P, T + 1, 2] metres, or [k, N, 1, T + 1, 2] and [k, 1, N, T + 1, 2].
        """
        count, people = self.samples.shape[:2]
        start = jnp.broadcast_to(self.last[:, None], (count, people, 1, 2))
        whole = jnp.concatenate([start, self.samples], axis=2)
        if self.pairs is None:
            return whole[:, :, None], whole[:, None]
        return whole[:, self.pairs[:, 0]], whole[:, self.pairs[:, 1]]


def pair_states_of(settings: SymbolSettings, futures: Futures) -> Array:
    """[k, P, T] or [k, N, N, T] rows of the pairs' states among those of the calculus."""
    states = observe(*futures.ends(), settings.calculus, **settings.thresholds)
    return state_index(settings.calculus, states)


def event_steps(settings: SymbolSettings, names: tuple[str, ...], futures: Futures) -> Array:
    """The step at which each of E events first happens.

    Returns:
        [E, k, P] or [E, k, N, N] int32 steps from 0; T where it does not happen.

    Raises:
        InputError: for an unknown event, or one that returns another shape or type than `Event`
            says.
    """
    k, l = futures.ends()
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
