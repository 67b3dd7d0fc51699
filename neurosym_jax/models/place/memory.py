"""What people did at a place: moments of the past, found by position and velocity.

A moment is one person at one step: a position, two velocities, and the way on from
there, which is known by the time that the moment is remembered. All functions are pure
and compiled, with shapes that depend on the bounds of the memory alone.

Moments are found through tables of cells, one table for each kernel. A cell is as wide
as the kernel, in position and velocity, and keeps the last moments of `CELL` different
people; so people who stand for an hour take one row, and a busy corner does not push
out what happened elsewhere. Cells share places of a table by a hash. A collision costs
nothing but room, since what is found is weighted by its true distance.

A turned kernel compares how people move, whichever way they face. What followed is
turned to the way that a person faces now, and is recalled in a mirror, too.

A moment also keeps the error of the forecast that the network made then. Where it errs
in the same way again, its error is added to what it forecasts now. And a way can be
averaged with what the network expects: few ways that lie far apart say where people go
better so.
"""

import dataclasses
import functools
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from neurosym_jax.scene import turned

__all__ = [
    "COMPONENTS",
    "FEATURES",
    "KERNELS",
    "Kernel",
    "Memory",
    "Recall",
    "empty_memory",
    "features",
    "forget",
    "recall",
    "remember",
]

FEATURES = 6
"""Position, velocity and earlier velocity: numbers by which moments are compared."""
STRIDE = 3
"""Steps over which a velocity is taken: trackers' noise is large over a single one."""
FAR = 3.0
"""Distance, in widths of a kernel, beyond which moments are not alike."""
ENOUGH = 8
"""People whose moments are alike, from which a kernel has its whole share."""
POINTS = 16
"""Ways on that are recalled at once for one person, by position and as many turned ones."""
FOUND = 64
"""Most similar moments among which those of `POINTS` different people are looked for."""
CELL = 8
"""Moments that a cell keeps."""
CORNERS = np.array(np.meshgrid(*[[0, 1]] * 4)).reshape(4, -1).T
"""[16, 4] offsets of the cells around a moment, two along each axis."""
PRIMES = np.array([73856093, 19349663, 83492791, 49979687], np.uint32)
"""Factors of the hash of a cell: M. Teschner et al., VMV 2003, section 4.1."""
MIRROR = np.array([1, -1, 1, -1, 1, -1], np.float32)
"""Factors of features seen in a mirror that lies along the velocity."""


@dataclasses.dataclass(frozen=True)
class Kernel:
    """How far apart two moments may lie and be alike.

    Their distance is that of the positions in units of `place`, that of the velocities
    in units of `speed`, and half of that of the earlier velocities, summed.
    """

    name: str
    place: float
    """Metres; infinite where it does not matter where people are."""
    speed: float
    """Metres per second."""
    turned: bool = False
    """Whether moments are compared in the directions of their own velocities."""
    errors: bool = False
    """Whether the network's errors are recalled, too; of a kernel that is not turned."""
    halfway: bool = False
    """Whether the points halfway between the ways and the network's mean are recalled, too; of a
    kernel that is not turned."""

    def likeness(self, place: Array, motion: Array) -> Array:
        """[...] weights, 1 for the same moment and 0 beyond `FAR`, see `_gaps`."""
        distance = place / self.place + motion / self.speed
        return jnp.where(distance < FAR, jnp.exp(-distance), 0)

    def scaled(self, moment: Array) -> Array:
        """[..., 4] position and velocity of `moment [..., 6]`, in widths.

        Of a turned kernel: nothing, the speed, and how fast a person went aside before.
        """
        if self.turned:
            seen = _from_within(moment)
            aside = jnp.abs(seen[..., 5]) / (2 * self.speed)
            motion = jnp.stack([seen[..., 2] / self.speed, aside], axis=-1)
            return jnp.concatenate([jnp.zeros_like(motion), motion], axis=-1)
        place = moment[..., :2] / self.place
        velocity = moment[..., 2:4] / self.speed
        return jnp.concatenate([place, velocity], -1)


def _gaps(moment: Array, others: Array) -> tuple[Array, Array]:
    """[N, n] how far `moment [N, 6]` lies from `others [N, n, 6]`: in position, and in motion.

    Motion is the velocity, and half of the earlier one.
    """
    # By coordinate: the CPU's programs are slow over short last axes. The barriers keep
    # them from gathering and taking roots once for each kernel.
    others = jax.lax.optimization_barrier(jnp.moveaxis(others, 2, 0))
    gap = jnp.square(moment.T[:, :, None] - others)
    place = jnp.sqrt(gap[0] + gap[1])
    motion = jnp.sqrt(gap[2] + gap[3]) + jnp.sqrt(gap[4] + gap[5]) / 2
    return jax.lax.optimization_barrier((place, motion))


def _direction(velocity: Array) -> Array:
    """[..., 2] of length 1; along x for who stands, and where there is no moment."""
    speed = jnp.linalg.norm(velocity, axis=-1, keepdims=True)
    moves = (speed > 0) & jnp.isfinite(speed)
    along_x = jnp.array([1.0, 0.0], velocity.dtype)
    return jnp.where(moves, velocity / jnp.where(moves, speed, 1), along_x)


def _from_within(moment: Array) -> Array:
    """`moment [..., 6]` as the person sees it: from the origin, with the velocity along x."""
    direction = _direction(moment[..., 2:4])
    velocity = turned(moment[..., 2:4], direction, -1)
    earlier = turned(moment[..., 4:6], direction, -1)
    origin = jnp.zeros_like(velocity)
    return jnp.concatenate([origin, velocity, earlier], axis=-1)


KERNELS = (
    Kernel("near", 1.5, 0.3, errors=True, halfway=True),
    Kernel("around", 3.0, 0.5, errors=True),
    Kernel("manner", np.inf, 0.15),
    Kernel("gait", np.inf, 0.15, turned=True),
)
"""The kernels of a place; `studies.place` says what they were chosen on."""
COMPONENTS = (
    {kernel.name: 1.0 for kernel in KERNELS}
    | {f"errors {kernel.name}": 0.1 for kernel in KERNELS if kernel.errors}
    | {f"halfway {kernel.name}": 1.0 for kernel in KERNELS if kernel.halfway}
)
"""First weights, in proportion, of the parts of a forecast that are recalled, by name. Errors help
where many people pass, and there a small weight grows soon."""


class Memory(NamedTuple):
    """Up to R moments, and where K kernels find them."""

    moment: Array
    """[R, 6] see `features`; infinite where there is none."""
    onward: Array
    """[R, T, 2] offsets from the position at the T steps that followed, metres."""
    error: Array
    """[R, T, 2] from the mean of the network's points to where the person was, metres; infinite
    where there was no forecast."""
    person: Array
    """[R] int32; -1 where there is no moment."""
    time: Array
    """[R] seconds since the first one."""
    table: Array
    """[K, S, CELL] int32 rows of the moments of each cell; R where there is none."""
    turn: Array
    """[K, S] int32: how many moments were put into each cell."""
    next: Array
    """[] int32: the row that is used next, the oldest one once all are in use."""


class Recall(NamedTuple):
    """What people like N others did, U ways on for each."""

    onward: Array
    """[N, U, T, 2] offsets from the last position, metres; or errors, or halves of offsets."""
    weight: Array
    """[N, C, U] probability of each by each component; sums to `min(1, people / ENOUGH)`, where
    a moment of one half-life ago counts for half a person, and one in a mirror for one
    more."""
    mean_part: Array
    """[U] the part of the network's mean that is added to each: 0 of ways, 1 of errors, see
    `Memory.error`, and 1/2 of those halfway."""

    def ways(self, expected: Array) -> Array:
        """[N, U, T, 2] offsets from the last position, with their part of what is `expected`.

        `expected [N, T, 2]` is the mean of the network's points.
        """
        return self.onward + self.mean_part[:, None, None] * expected[:, None]


def empty_memory(moments: int, steps: int) -> Memory:
    """A memory for so many `moments` with `steps` that follow."""
    exponent = np.ceil(np.log2(max(moments, CELL) / 12))
    slots = 1 << max(int(exponent), 4)
    return Memory(
        moment=jnp.full((moments, FEATURES), jnp.inf, jnp.float32),
        onward=jnp.zeros((moments, steps, 2), jnp.float32),
        error=jnp.zeros((moments, steps, 2), jnp.float32),
        person=jnp.full(moments, -1, jnp.int32),
        time=jnp.full(moments, -jnp.inf, jnp.float32),
        table=jnp.full((len(KERNELS), slots, CELL), moments, jnp.int32),
        turn=jnp.zeros((len(KERNELS), slots), jnp.int32),
        next=jnp.zeros((), jnp.int32),
    )


def features(track: np.ndarray, period: float) -> np.ndarray:
    """[N, 6] features of the last of the steps `track [N, S, 2]`, S > 3.

    Where fewer than seven steps are there, the velocity stands for the earlier one.
    """
    seconds = STRIDE * period
    velocity = (track[:, -1] - track[:, -1 - STRIDE]) / seconds
    earlier = velocity
    if track.shape[1] > 2 * STRIDE:
        earlier = (track[:, -1 - STRIDE] - track[:, -1 - 2 * STRIDE]) / seconds
    return np.concatenate([track[:, -1], velocity, earlier], axis=1)


@functools.partial(jax.jit, static_argnums=0, donate_argnums=1)
def remember(
    kernels: tuple[Kernel, ...],
    memory: Memory,
    moment: Array,
    onward: Array,
    error: Array,
    person: Array,
    time: Array,
) -> Memory:
    """The memory with n more moments, one after the other; `memory` itself is used up.

    Args:
        kernels: K of them.
        memory: of R moments.
        moment: [n, 6].
        onward: [n, T, 2].
        error: [n, T, 2].
        person: [n] int32; nothing is remembered of a negative one.
        time: [n] seconds.
    """
    rows = len(memory.person)
    index = jnp.arange(len(kernels))

    def add(number: Array, memory: Memory) -> Memory:
        seen = moment[number]
        owner = person[number]
        homes = [_home(memory, kernel, seen, owner) for kernel in kernels]
        slots = jnp.stack(homes)
        entries = memory.table[index, slots]  # [K, CELL]
        owners = memory.person.at[entries].get(mode="fill", fill_value=-2)
        mine = owners == owner
        again = mine.any(axis=1)
        own_row = entries[0, mine[0].argmax()]
        row = jnp.where(again[0], own_row, memory.next)
        row = jnp.where(owner < 0, rows, row)
        own_place = mine.argmax(axis=1)
        next_place = memory.turn[index, slots] % CELL
        place = jnp.where(again, own_place, next_place)
        slots = jnp.where(owner < 0, memory.turn.shape[1], slots)
        is_new = (row == memory.next) & (owner >= 0)
        following = (memory.next + 1) % rows
        return memory._replace(
            moment=memory.moment.at[row].set(seen, mode="drop"),
            onward=memory.onward.at[row].set(onward[number], mode="drop"),
            error=memory.error.at[row].set(error[number], mode="drop"),
            person=memory.person.at[row].set(owner, mode="drop"),
            time=memory.time.at[row].set(time[number], mode="drop"),
            table=memory.table.at[index, slots, place].set(row, mode="drop"),
            turn=memory.turn.at[index, slots].add(~again, mode="drop"),
            next=jnp.where(is_new, following, memory.next),
        )

    return jax.lax.fori_loop(0, len(person), add, memory)


@functools.partial(jax.jit, static_argnums=0)
def recall(
    kernels: tuple[Kernel, ...],
    memory: Memory,
    moment: Array,
    now: Array | float = 0.0,
    half_life: Array | float = np.inf,
) -> Recall:
    """What people did from moments like `moment [N, 6]`, by each component.

    Components are the kernels, then the errors of those that have them, and then what
    lies halfway. A moment counts for half after `half_life` [] seconds before `now` [].
    """
    groups = [
        _recall_alike(kernels, is_turned, memory, moment, now, half_life)
        for is_turned in sorted({kernel.turned for kernel in kernels})
    ]
    onward = jnp.concatenate([group.onward for group in groups], axis=1)
    weight = jnp.concatenate([group.weight for group in groups], axis=2)

    alike = groups[0]
    is_known = jnp.isfinite(alike.error).all(axis=(2, 3))
    error = jnp.where(is_known[..., None, None], alike.error, 0)
    errors = [number for number, kernel in enumerate(kernels) if kernel.errors]
    halfway = [number for number, kernel in enumerate(kernels) if kernel.halfway]
    blocks = [
        weight,
        alike.weight[:, errors] * is_known[:, None],
        alike.weight[:, halfway],
    ]
    parts = [0.0] * onward.shape[1] + [1.0] * POINTS + [0.5] * POINTS
    return Recall(
        onward=jnp.concatenate([onward, error, alike.onward / 2], axis=1),
        weight=_block_diagonal(blocks),
        mean_part=jnp.array(parts, onward.dtype),
    )


def _block_diagonal(blocks: list[Array]) -> Array:
    """[N, sum of K, sum of U] with `blocks [N, K, U]` along the diagonal, and zeros."""
    total = sum(block.shape[2] for block in blocks)
    rows, begin = [], 0
    for block in blocks:
        after = total - begin - block.shape[2]
        rows.append(jnp.pad(block, [(0, 0), (0, 0), (begin, after)]))
        begin += block.shape[2]
    return jnp.concatenate(rows, axis=1)


class _Alike(NamedTuple):
    """The most similar moments, by kernels that are turned, or by the others."""

    onward: Array
    """[N, U, T, 2] see `Recall`."""
    error: Array
    """[N, U, T, 2] of the same moments, as they were."""
    weight: Array
    """[N, K, U] by each of all kernels."""


def _recall_alike(
    kernels: tuple[Kernel, ...],
    is_turned: bool,
    memory: Memory,
    moment: Array,
    now: Array | float,
    half_life: Array | float,
) -> _Alike:
    """What kernels recall that are turned, or those that are not; the others have no weight."""
    rows = []
    for number, kernel in enumerate(kernels):
        if kernel.turned == is_turned:
            slots = _around(memory, kernel, moment)
            entries = memory.table[number, slots]  # [N, 16, CELL]
            rows.append(entries.reshape(len(moment), -1))
    row = jnp.concatenate(rows, axis=1)
    others = memory.moment.at[row].get(mode="fill", fill_value=jnp.inf)
    person = memory.person.at[row].get(mode="fill", fill_value=-1)
    seen = moment
    if is_turned:
        seen, others = _from_within(moment), _from_within(others)
        others = jnp.concatenate([others, others * MIRROR], axis=1)
        row = jnp.concatenate([row, row], axis=1)
        # Somebody in a mirror is another person.
        person = jnp.concatenate([person, ~person], axis=1)

    gaps = _gaps(seen, others)
    time = memory.time.at[row].get(mode="fill", fill_value=-jnp.inf)
    # An empty row has an infinite age, of which an infinite half-life makes NaN.
    age = jnp.where(time > -jnp.inf, now - time, 0)
    kept = jnp.exp2(-jnp.maximum(age, 0) / half_life)
    nothing = jnp.zeros_like(kept)
    weight = jnp.stack(
        [
            kernel.likeness(*gaps) * kept if kernel.turned == is_turned else nothing
            for kernel in kernels
        ],
        axis=1,
    )
    total = jnp.maximum(weight.sum(axis=2, keepdims=True), 1e-9)
    likeness = (weight / total).sum(axis=1)

    best, likeness = _best_of_people(person, likeness)
    weight = jnp.take_along_axis(weight, best[:, None], axis=2)
    weight = jnp.where(likeness[:, None] > 0, weight, 0)
    kept = jnp.take_along_axis(kept, best, axis=1)
    people = jnp.where(weight > 0, kept[:, None], 0).sum(axis=2, keepdims=True)
    share = jnp.minimum(people / ENOUGH, 1)
    total = jnp.maximum(weight.sum(axis=2, keepdims=True), 1e-9)
    row = jnp.take_along_axis(row, best, axis=1)
    onward = memory.onward.at[row].get(mode="fill", fill_value=0)
    error = memory.error.at[row].get(mode="fill", fill_value=0)
    if is_turned:
        was = memory.moment.at[row, 2:4].get(mode="fill", fill_value=0)
        is_mirrored = best >= others.shape[1] // 2
        onward = _turned_ways(onward, was, is_mirrored, moment[:, None, 2:4])
    return _Alike(onward, error, share * weight / total)


def _best_of_people(person: Array, likeness: Array) -> tuple[Array, Array]:
    """[N, U] the most similar moments of different people, and their likeness, 0 if none.

    `person [N, n]` says whose the moments are, `likeness [N, n]` how similar.
    """
    likeness, best = jax.lax.top_k(likeness, FOUND)
    person = jnp.take_along_axis(person, best, axis=1)
    same = person[:, :, None] == person[:, None]
    repeated = jnp.tril(same, -1).any(axis=2)
    likeness = jnp.where(repeated, 0, likeness)
    likeness, order = jax.lax.top_k(likeness, POINTS)
    return jnp.take_along_axis(best, order, axis=1), likeness


def _turned_ways(
    onward: Array, was: Array, is_mirrored: Array, velocity: Array
) -> Array:
    """Ways `onward [N, U, T, 2]` of people whose velocity `was [N, U, 2]`, for `velocity [N, 1, 2]`."""
    way = turned(onward, _direction(was)[:, :, None], -1)
    aside = jnp.where(is_mirrored[..., None], -way[..., 1], way[..., 1])
    way = jnp.stack([way[..., 0], aside], axis=-1)
    return turned(way, _direction(velocity)[:, :, None], 1)


@jax.jit
def forget(memory: Memory, before: Array) -> Memory:
    """The memory without moments from up to a time, `before` [] seconds."""
    old = memory.time <= before
    return memory._replace(
        moment=jnp.where(old[:, None], jnp.inf, memory.moment),
        person=jnp.where(old, -1, memory.person),
    )


def _home(memory: Memory, kernel: Kernel, moment: Array, person: Array) -> Array:
    """[] the place in a table of the cell that keeps `moment [6]` of a person."""
    cell = jnp.floor(kernel.scaled(moment)).astype(jnp.int32)
    if np.isinf(kernel.place):
        # Four cells in place of one, for different people.
        corner = jnp.stack([person % 2, person // 2 % 2])
        cell = cell.at[:2].set(corner)
    return _slot(memory, cell)


def _around(memory: Memory, kernel: Kernel, moment: Array) -> Array:
    """[N, 16] places in a table of the cells nearest to `moment [N, 6]`."""
    lowest = jnp.floor(kernel.scaled(moment) - 0.5)
    cell = lowest.astype(jnp.int32)[:, None] + CORNERS
    if np.isinf(kernel.place):
        cell = cell.at[..., :2].set(CORNERS[:, :2])
    return _slot(memory, cell)


def _slot(memory: Memory, cell: Array) -> Array:
    """[...] hash of `cell [..., 4]`, a place in a table."""
    mixed = cell.astype(jnp.uint32) * PRIMES
    mixed = mixed[..., 0] ^ mixed[..., 1] ^ mixed[..., 2] ^ mixed[..., 3]
    mixed = (mixed ^ (mixed >> 15)) * jnp.uint32(2654435761)
    return (mixed >> 8) % memory.turn.shape[1]
