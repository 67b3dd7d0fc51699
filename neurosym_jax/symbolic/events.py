"""Events of a pair, such as passing or meeting: expressions over its symbols and distances.

`EVENTS` lists those that the package brings; `register_event` adds one. An event says
at which steps it happens; `forecast` says how probable it is in sampled futures, and
when it happens.
"""

import dataclasses
import functools
import math
from collections.abc import Callable

import jax.numpy as jnp
from jax import Array

from neurosym_jax.plugins import Registry
from neurosym_jax.symbolic.qtc import ABSENT

__all__ = ["EVENTS", "Event", "PairFuture", "register_event"]


@dataclasses.dataclass(frozen=True)
class PairFuture:
    """The future of pairs (k, l) over T steps, with any leading axes; step t ends at `period` t.

    `who` in its methods is `"k"` or `"l"`.
    """

    states: Array
    """[..., T, 4] int8 of QTC_C1, in {-1, 0, 1}, or `ABSENT`: no event happens then."""
    k: Array
    """[..., T + 1, 2] metres, the last position observed first."""
    l: Array
    """[..., T + 1, 2] metres, see `k`."""
    period: float
    """Seconds between steps."""
    speed: float
    """Speed below which a person counts as standing, m/s."""

    def towards(self, who: str) -> Array:
        """[..., T] bool: `who` moves towards the other."""
        return self.states[..., "kl".index(who)] == -1

    def away(self, who: str) -> Array:
        """[..., T] bool: `who` moves away from the other."""
        return self.states[..., "kl".index(who)] == 1

    def side(self, who: str) -> Array:
        """[..., T] side of `who`'s way on which the other is: -1 right, 1 left, 0 straight on."""
        # `who` moves to the right (q3 is +) of the line to someone on the left.
        side = self.states[..., 2 + "kl".index(who)]
        return jnp.where(side == ABSENT, 0, side)

    @property
    def passes(self) -> Array:
        """[..., T] bool: k, who walked towards l, walks away, within 3 m."""
        away = self.away("k")
        retreat = away.astype(jnp.int8) - self.towards("k").astype(jnp.int8)
        return self.turns(retreat) & away & self.within(3)

    @property
    def order(self) -> Array:
        """[..., T] int8: -1 where k walks behind l, towards l who walks away, 1 ahead, else 0."""
        behind = self.towards("k") & self.away("l")
        ahead = self.away("k") & self.towards("l")
        return ahead.astype(jnp.int8) - behind.astype(jnp.int8)

    def place(self, who: str) -> tuple[Array, Array]:
        """Where the other is at the end of each step: [..., T] int8 1 left, -1 right; bool ahead.

        While `who` stands these are 0 and False.
        """
        own, other = self.k, self.l
        if who == "l":
            own, other = other, own
        move = jnp.diff(own, axis=-2)
        offset = (other - own)[..., 1:, :]
        moves = jnp.linalg.norm(move, axis=-1) > self.speed * self.period
        left = move[..., 0] * offset[..., 1] - move[..., 1] * offset[..., 0]
        side = jnp.where(moves, jnp.sign(left), 0)
        along = (move * offset).sum(axis=-1)
        return side.astype(jnp.int8), moves & (along > 0)

    def crosses(self, who: str) -> Array:
        """[..., T] bool: `who` crosses the other's way at 30 to 150 degrees within 5 m."""
        side, _ = self.place("l" if who == "k" else "k")
        return self.turns(side) & self.angle_between(30, 150) & self.within(5)

    @functools.cached_property
    def distance(self) -> Array:
        """[..., T + 1] metres between k and l, the last observed first."""
        return jnp.linalg.norm(self.k - self.l, axis=-1)

    def within(self, metres: float) -> Array:
        """[..., T] bool: their distance at the end of the step is at most `metres`."""
        return self.distance[..., 1:] <= metres

    def angle_between(self, low: float, high: float) -> Array:
        """[..., T] bool: both walk, and their directions differ by `low` to `high` degrees."""
        move = jnp.diff(self.k, axis=-2)
        other_move = jnp.diff(self.l, axis=-2)
        product = (move * other_move).sum(axis=-1)
        length = jnp.linalg.norm(move, axis=-1)
        lengths = length * jnp.linalg.norm(other_move, axis=-1)
        least = jnp.cos(jnp.radians(high)) * lengths
        most = jnp.cos(jnp.radians(low)) * lengths
        return (product >= least) & (product <= most) & (lengths > 0)

    def lasting(self, condition: Array, seconds: float) -> Array:
        """[..., T] bool: `condition` [..., T] holds and has held for at least this long."""
        held = condition
        for steps in range(1, math.ceil(seconds / self.period - 1e-6)):
            held = held & _shifted(condition, steps)
        return held

    @staticmethod
    def turns(sign: Array) -> Array:
        """[..., T] bool: a sign [..., T] is the opposite of its last value that was not 0."""
        before = _shifted(sign, 1)
        reach = 1
        while reach < sign.shape[-1]:
            before = jnp.where(before != 0, before, _shifted(before, reach))
            reach *= 2
        return before * sign < 0


@dataclasses.dataclass(frozen=True)
class Event:
    """Something that a pair (k, l) does."""

    sentence: str
    """What happens, in words, of k and l."""
    happens: Callable[[PairFuture], Array]
    """[..., T] bool: at which steps; a function that `jax.jit` can take."""
    short: str = ""
    """Such as `{k} follows {l}`; by default its name between the two."""

    def in_short(self, name: str) -> str:
        """The event `name` in a few words, with `{k}` and `{l}` in place of the two."""
        return self.short or f"{{k}} {name.replace('_', ' ')} {{l}}"

    @property
    def mutual(self) -> bool:
        """Whether it happens to (l, k) as well, so that it is reported once: `{k} and {l} ...`."""
        return self.short.startswith("{k} and {l}")


def _shifted(array: Array, steps: int) -> Array:
    """`array` [..., T] as of `steps` steps before, zeros (False) before the first."""
    padding = [(0, 0)] * (array.ndim - 1) + [(steps, 0)]
    return jnp.pad(array, padding)[..., : array.shape[-1]]


EVENTS: Registry[Event] = Registry(
    "event",
    {
        "approaches": Event(
            "k walks towards l for 1.2 s", lambda e: e.lasting(e.towards("k"), 1.2)
        ),
        "passes_left": Event(
            "k, who walked towards l, walks away, with l at k's left hand within 3 m",
            lambda e: e.passes & (e.side("k") > 0),
            "{k} passes with {l} on the left",
        ),
        "passes_right": Event(
            "k, who walked towards l, walks away, with l at k's right hand within 3 m",
            lambda e: e.passes & (e.side("k") < 0),
            "{k} passes with {l} on the right",
        ),
        "crosses_before": Event(
            "k comes from one side of l's way to the other, 30 to 150 degrees, ahead of l within "
            "5 m",
            lambda e: e.crosses("k") & e.place("l")[1],
        ),
        "crosses_behind": Event(
            "k comes from one side of l's way to the other, 30 to 150 degrees, behind l within 5 m",
            lambda e: e.crosses("k") & ~e.place("l")[1],
        ),
        "follows": Event(
            "k walks towards l and l away from k, in directions less than 45 degrees apart and "
            "within 4 m, for 1.2 s",
            lambda e: e.lasting(
                e.towards("k") & e.away("l") & e.angle_between(0, 45) & e.within(4), 1.2
            ),
        ),
        "overtakes": Event(
            "k, who walked behind l, walks ahead of l, in directions less than 45 degrees apart "
            "and within 3 m",
            lambda e: (
                e.turns(e.order) & (e.order > 0) & e.angle_between(0, 45) & e.within(3)
            ),
        ),
        "meets": Event(
            "k and l, who were farther apart a step before, are within 1.2 m of each other",
            lambda e: e.within(1.2) & (e.distance[..., :-1] > 1.2),
            "{k} and {l} meet",
        ),
    },
)

register_event = EVENTS.register
