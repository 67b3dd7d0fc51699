"""What two people do, in words: each event is an expression over a pair's symbols and distances.

The table at the end is all there is to know of the events that the package brings; `register_event`
adds one from a file of one's own. An event says at which steps it happens; whether and when it does
in each of several sampled futures, and how probable it is then, is `forecast`'s.
"""

import dataclasses
import functools
from collections.abc import Callable

import jax.numpy as jnp
from jax import Array

from neurosym_jax.errors import InputError
from neurosym_jax.registry import Registry

__all__ = ["EVENTS", "Encounter", "Event", "events_named", "in_short", "register_event"]


@dataclasses.dataclass(frozen=True)
class Encounter:
    """The future of pairs (k, l) over T steps, of any leading axes; step t ends at `period` t."""

    states: Array
    """[..., T, 4] int8 of QTC_C1, in {-1, 0, 1}."""
    k: Array
    """[..., T + 1, 2] metres, the last position observed first."""
    l: Array  # noqa: E741 (the calculus calls the two points k and l)
    """[..., T + 1, 2] metres, see `k`."""
    period: float
    """Seconds between steps."""
    speed: float
    """Metres per second up to which somebody stands."""

    def towards(self, who: str) -> Array:
        """[..., T] whether `who` (`"k"` or `"l"`) moves towards the other."""
        return self.states[..., "kl".index(who)] < 0

    def away(self, who: str) -> Array:
        """[..., T] whether `who` moves away from the other."""
        return self.states[..., "kl".index(who)] > 0

    def side(self, who: str) -> Array:
        """[..., T] on which side of `who`'s way the other is: -1 right, 1 left, 0 straight on.

        `who` moves to the right (q3 is +) of the line to somebody on the left.
        """
        return self.states[..., 2 + "kl".index(who)]

    @property
    def order(self) -> Array:
        """[..., T] int8 -1 where k walks towards l, who walks away, 1 where l does so, else 0."""
        after, ahead = self.towards("k") & self.away("l"), self.away("k") & self.towards("l")
        return ahead.astype(jnp.int8) - after.astype(jnp.int8)

    def place(self, who: str) -> tuple[Array, Array]:
        """Where the other is at the end of each step, seen from `who`'s way.

        Returns:
            [..., T] int8 1 on the left and -1 on the right, 0 on the line of the step; and [..., T]
            bool whether ahead. Of who stands these are 0 and False.
        """
        own, other = (self.k, self.l) if who == "k" else (self.l, self.k)
        v, to = jnp.diff(own, axis=-2), (other - own)[..., 1:, :]
        moves = _length(v) > self.speed * self.period
        left = v[..., 0] * to[..., 1] - v[..., 1] * to[..., 0]
        along = (v * to).sum(axis=-1)
        return jnp.where(moves, jnp.sign(left), 0).astype(jnp.int8), moves & (along > 0)

    def crosses(self, who: str) -> Array:
        """[..., T] whether `who` comes from one side of the other's way to the other side.

        At 30 to 150 degrees, both walking, within 5 m.
        """
        side, _ = self.place("l" if who == "k" else "k")
        return self.turns(side) & self.angle_between(30, 150) & self.within(5)

    @functools.cached_property
    def distance(self) -> Array:
        """[..., T + 1] metres between k and l, the last observed first."""
        return _length(self.k - self.l)

    def within(self, metres: float) -> Array:
        """[..., T] whether they are that near at the end of the step."""
        return self.distance[..., 1:] <= metres

    def angle_between(self, low: float, high: float) -> Array:
        """[..., T] whether k's and l's directions differ by so many degrees; False if one stands.

        Args:
            low: degrees, 0 to 180.
            high: degrees, 0 to 180.
        """
        v, w = jnp.diff(self.k, axis=-2), jnp.diff(self.l, axis=-2)
        lengths = _length(v) * _length(w)
        cosine = (v * w).sum(axis=-1)
        least, most = jnp.cos(jnp.radians(high)), jnp.cos(jnp.radians(low))
        fits = (cosine >= least * lengths) & (cosine <= most * lengths)
        return fits & (lengths > 0)

    def lasting(self, what: Array, seconds: float) -> Array:
        """[..., T] whether `what` [..., T] has been so for this long, and is."""
        held = what
        for steps in range(1, round(seconds / self.period)):
            held = held & _shifted(what, steps)
        return held

    @staticmethod
    def turns(sign: Array) -> Array:
        """[..., T] whether a sign [..., T] is now the opposite of what it was before it was 0."""
        before, reach = _shifted(sign, 1), 1
        while reach < sign.shape[-1]:
            before = jnp.where(before != 0, before, _shifted(before, reach))
            reach *= 2
        return before * sign < 0


@dataclasses.dataclass(frozen=True)
class Event:
    """Something that a pair (k, l) does."""

    sentence: str
    """What happens, in words, of k and l."""
    happens: Callable[[Encounter], Array]
    """[..., T] bool: at which steps; a function that `jax.jit` can take."""
    short: str = ""
    """Such as `{k} follows {l}`; empty where its name between the two says enough."""

    @property
    def mutual(self) -> bool:
        """Whether it happens to (l, k) as well, and need be told once: `{k} and {l} ...`."""
        return self.short.startswith("{k} and {l}")


EVENTS: Registry[Event] = Registry("event")


def register_event(name: str, event: Event, *, replace: bool = False) -> None:
    """Add an event, which is then forecast, scored and shown like the others.

    Raises:
        InputError: for a name that is taken or cannot be one.
    """
    EVENTS.register(name, event, replace=replace)


def events_named(names: tuple[str, ...] | None = None) -> dict[str, Event]:
    """The events of these names, in this order; all without.

    Raises:
        InputError: for a name that nobody registered.
    """
    if names is not None and len(set(names)) < len(names):
        raise InputError(f"an event is named twice: {', '.join(names)}")
    return {name: EVENTS[name] for name in (EVENTS if names is None else names)}


def in_short(name: str) -> str:
    """What an event is in a few words, with `{k}` and `{l}` in place of the two."""
    return EVENTS[name].short or f"{{k}} {name.replace('_', ' ')} {{l}}"


def _length(offset: Array) -> Array:
    return jnp.sqrt(jnp.square(offset).sum(axis=-1))


def _shifted(array: Array, steps: int) -> Array:
    """`array` [..., T] of so many steps before, zeros (False) before the first."""
    kept = array[..., : max(0, array.shape[-1] - steps)]
    missing = array.shape[-1] - kept.shape[-1]
    return jnp.pad(kept, [(0, 0)] * (array.ndim - 1) + [(missing, 0)])


for _name, _sentence, _happens, *_more in (
    (
        "approaches",
        "k walks towards l for 1.2 s",
        lambda e: e.lasting(e.towards("k"), 1.2),
    ),
    (
        "passes_left",
        "k, who walked towards l, walks away, with l at k's left hand within 3 m",
        lambda e: e.turns(e.states[..., 0]) & e.away("k") & (e.side("k") > 0) & e.within(3),
        "{k} passes with {l} on the left",
    ),
    (
        "passes_right",
        "k, who walked towards l, walks away, with l at k's right hand within 3 m",
        lambda e: e.turns(e.states[..., 0]) & e.away("k") & (e.side("k") < 0) & e.within(3),
        "{k} passes with {l} on the right",
    ),
    (
        "crosses_before",
        "k comes from one side of l's way to the other, 30 to 150 degrees, ahead of l within 5 m",
        lambda e: e.crosses("k") & e.place("l")[1],
    ),
    (
        "crosses_behind",
        "k comes from one side of l's way to the other, 30 to 150 degrees, behind l within 5 m",
        lambda e: e.crosses("k") & ~e.place("l")[1],
    ),
    (
        "follows",
        "k walks towards l and l away from k, in directions less than 45 degrees apart and within "
        "4 m, for 1.2 s",
        lambda e: e.lasting(
            e.towards("k") & e.away("l") & e.angle_between(0, 45) & e.within(4), 1.2
        ),
    ),
    (
        "overtakes",
        "k, who walked behind l, walks ahead of l, in directions less than 45 degrees apart and "
        "within 3 m",
        lambda e: e.turns(e.order) & (e.order > 0) & e.angle_between(0, 45) & e.within(3),
    ),
    (
        "meets",
        "k and l, who were farther apart a step before, are within 1.2 m of each other",
        lambda e: e.within(1.2) & (e.distance[..., :-1] > 1.2),
        "{k} and {l} meet",
    ),
):
    register_event(_name, Event(_sentence, _happens, *_more))
