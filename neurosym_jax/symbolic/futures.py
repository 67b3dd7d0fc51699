"""Sampled futures of pairs: what counts as a movement, states and events sample by sample.

Thresholds are physical, metres and metres per second, so that they mean the same at every period.
The first step leads from the last position observed. How samples become probabilities is said by
`forecast`.
"""

import dataclasses
import math
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import ArrayLike

from neurosym_jax.configuration import NotNegative, Positive, refuse_misfits
from neurosym_jax.errors import InputError
from neurosym_jax.symbolic.calculi import CALCULI, observe, state_index
from neurosym_jax.symbolic.events import Encounter, events_named
from neurosym_jax.symbolic.qtc import Convention, other_pairs

__all__ = ["Futures", "SymbolSettings", "event_steps", "pair_states_of", "settings_of"]


@dataclasses.dataclass(frozen=True)
class SymbolSettings:
    """What counts as a movement, and how counts become probabilities."""

    period: Positive = 0.4
    """Seconds between steps."""
    calculus: str = "c1"
    """Of the states, by name; events are of QTC_C1."""
    convention: Convention = "distance"
    """See `qtc`."""
    speed: NotNegative = 0.125
    """Metres per second up to which a movement towards, away or to a side is none."""
    angle: NotNegative = 0.0
    """Degrees up to which two angles are equal, for the symbol q6."""
    near: NotNegative = 1.22
    """Metres up to which a pair of QTC_BC has sides."""
    apart: NotNegative | None = None
    """Metres beyond which it has none again; None is `near`."""
    smoothing: NotNegative = 1.0
    """Weight of the prior in samples, see the module; 0 leaves shares as they are counted."""

    def __post_init__(self):
        """Refuse what cannot be."""
        refuse_misfits(self)
        if self.calculus not in CALCULI:
            raise InputError(f"unknown calculus {self.calculus!r}: there are {', '.join(CALCULI)}")

    @property
    def thresholds(self) -> dict[str, Any]:
        """As `calculi.observe` takes them, in metres per step and radians."""
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
    """What people may do, and the pairs of them that are looked at."""

    samples: Array
    """[k, N, T, 2] metres."""
    last: Array
    """[N, 2] metres, the last positions observed."""
    pairs: Array | None = None
    """[P, 2] ordered pairs (k, l) of agents; None for all, [N, N]."""

    @classmethod
    def of(cls, samples: ArrayLike, observed: ArrayLike, pairs: ArrayLike | None) -> "Futures":
        """Those of `samples [k, N, T, 2]` after `observed [N, obs_len, 2]`, in metres.

        Raises:
            InputError: for shapes that do not fit, or a pair of somebody who is not there.
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
            # Far from the origin float32 loses what differences are made of.
            origin = last.astype(np.float64).mean(axis=0)
            given, last = given - origin, last - origin
        if pairs is not None:
            if isinstance(pairs, np.ndarray | list) and not np.isin(pairs, range(seen[0])).all():
                raise InputError(f"pairs must name people by 0 to {seen[0] - 1}")
            pairs = jnp.asarray(pairs, int).reshape(-1, 2)
        return cls(jnp.asarray(given, float), jnp.asarray(last, float), pairs)

    def others(self, valid: ArrayLike | None) -> Array:
        """[P] or [N, N] bool: pairs of two people, who are `valid [N]`."""
        others = other_pairs(valid, len(self.last))
        return others if self.pairs is None else others[tuple(self.pairs.T)]

    def ends(self) -> tuple[Array, Array]:
        """Positions of k and of l from the last observed on.

        [k, P, T + 1, 2] metres, or [k, N, 1, T + 1, 2] and [k, 1, N, T + 1, 2].
        """
        count, people = self.samples.shape[:2]
        start = jnp.broadcast_to(self.last[:, None], (count, people, 1, 2))
        whole = jnp.concatenate([start, self.samples], axis=2)
        if self.pairs is None:
            return whole[:, :, None], whole[:, None]
        return whole[:, self.pairs[:, 0]], whole[:, self.pairs[:, 1]]


def pair_states_of(settings: SymbolSettings, futures: Futures) -> Array:
    """[k, P, T] or [k, N, N, T] rows of the pairs' states among those of the calculus."""
    k, l = futures.ends()  # noqa: E741
    return state_index(settings.calculus, observe(settings.calculus, k, l, **settings.thresholds))


def event_steps(settings: SymbolSettings, names: tuple[str, ...], futures: Futures) -> Array:
    """When each of E events first happens.

    Args:
        settings: of the thresholds.
        names: of the events.
        futures: of the pairs.

    Returns:
        [E, k, P] or [E, k, N, N] int32 steps from 0; T where it does not happen.

    Raises:
        InputError: for an event that is unknown or gives something else than it should.
    """
    k, l = futures.ends()  # noqa: E741
    states = observe("c1", k, l, **settings.thresholds)
    k, l = jnp.broadcast_arrays(k, l)  # noqa: E741
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


def settings_of(given: dict[str, Any]) -> SymbolSettings:
    """Settings by name.

    Raises:
        InputError: for a setting that there is not, or a value that does not fit.
    """
    known = [field.name for field in dataclasses.fields(SymbolSettings)]
    if unknown := given.keys() - set(known):
        raise InputError(f"unknown setting {min(unknown)!r}: there are {', '.join(known)}")
    return SymbolSettings(**given)
