"""Embedded default data: two people in a 5 m x 8.2 m room for two minutes, simulated from a seed.

The scenarios are those the NeuroSyM robot experiment describes: `all-forward`, people walking side
by side to the room's end and back, and `cross-path`, people who cross each other's way and avoid
each other. Both are walks of a social-force model, seen by a 10 Hz tracker whose faults can be
switched on. They are not recordings, and results on them say nothing about a method's rank on
real people; they are here so that everything runs, and can be tested, without a download.

The forces are those of D. Helbing and P. Molnár, "Social force model for pedestrian dynamics",
Phys. Rev. E 51, 4282 (1995): relaxation to a desired velocity in 0.5 s, elliptical exponential
repulsion between people (their V0 = 2.1 m^2/s^2 and sigma = 0.3 m, half effect outside a view of
200 degrees), exponential repulsion from walls, speed limited to 1.3 times the desired. The ellipse
follows the relative velocity, as in A. Johansson, D. Helbing and P. Shukla, "Specification of the
social force pedestrian model by evolutionary adjustment to video tracking data", Adv. Complex
Syst. 10, 271 (2007): with the other's velocity alone, people in a room this small jump back.

Assumed by us, because no source fixes it: the anticipation of 1 s, a body of 0.2 m inside the
repulsion and a contact force below 0.5 m, a softer wall, a heading that turns at most 2.5 rad/s,
braking before the goal and pausing there for one's partner, slow random changes of pace and
heading, and, in place of an attraction, a spring that keeps a pair 0.8 m abreast. Gait sway,
bystanders and the robot are left out.
"""

import dataclasses
import functools
from typing import Literal, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from neurosym_jax.data.tracks import Tracks, make_tracks, resample
from neurosym_jax.errors import InputError

__all__ = [
    "ROOM",
    "Scenario",
    "TrackerFaults",
    "ground_truth",
    "simulate",
    "simulate_labelled",
    "synthetic_tracks",
]

Scenario = Literal["all-forward", "cross-path"]

ROOM = (5.0, 8.2)
"""Metres along x and y; one corner is the origin."""

PERIOD = 0.4  # seconds between the points of the ETH/UCY protocol

MAX_STEP = 0.05  # s, of the Euler integration
RELAXATION = 0.5  # s
REPULSION, RANGE = 2.1, 0.3  # m^2/s^2, m
ANTICIPATION = 1.0  # s of coming relative motion; 2 s in 1995, for walks longer than a room
BODY = 0.2  # m, taken off a distance before the repulsion is evaluated
BEHIND = 0.5  # of the repulsion by people out of view
HALF_VIEW = np.deg2rad(100.0)
WALL, WALL_RANGE = 1.0, 0.2  # m^2/s^2, m
CONTACT, TOUCH = 30.0, 0.5  # 1/s^2, m: people nearer than this, a pair too, push apart
MARGIN = 0.25  # m; nobody's centre comes nearer to a wall
TOP_SPEED = 1.3  # of the desired speed
TURN_RATE = 2.5  # rad/s
ABREAST = 0.8  # m between the two of a pair
SPRING, DAMPING = 2.0, 1.0  # 1/s^2, 1/s: of a pair
BRAKING, ARRIVED = 0.8, 0.3  # m from the goal
PATIENCE = 15.0  # s on one leg, after which a blocked person is content with the place reached
WOBBLE = (0.06, 0.10)  # standard deviations of relative pace and of heading (rad)
WOBBLE_TIME = 1.5  # s
SWAP_DISTANCE = 0.8  # m within which a tracker can mistake two people for each other


@dataclasses.dataclass(frozen=True)
class TrackerFaults:
    """What a tracker does to the truth; the default is a good tracker with a little noise."""

    noise: float = 0.02
    """Standard deviation in metres of each coordinate."""
    dropout: float = 0.0
    """Probability per frame and person of losing the person."""
    dropout_seconds: float = 1.0
    """Mean length of a loss, geometrically distributed, at least one frame."""
    id_switch: float = 0.0
    """Probability that a lost person comes back under a new id."""
    id_swap: float = 0.0
    """Probability per frame that two people within 0.8 m exchange their ids."""

    def __post_init__(self):
        """Refuse what is not a probability, a length or a duration."""
        for name in ("dropout", "id_switch", "id_swap"):
            if not 0 <= getattr(self, name) <= 1:
                raise InputError(f"{name} must be a probability, not {getattr(self, name)}")
        for name in ("noise", "dropout_seconds"):
            if not 0 <= getattr(self, name) < float("inf"):
                raise InputError(f"{name} must not be negative, not {getattr(self, name)}")


def synthetic_tracks(scenario: Scenario, seed: int = 0) -> Tracks:
    """Two minutes of two people as a good tracker sees them, resampled to 0.4 s: 301 points each.

    Raises:
        InputError: for an unknown scenario or a seed outside 0 .. 2**32 - 1.
    """
    return resample(simulate(scenario, seed), PERIOD)


def simulate(
    scenario: Scenario,
    seed: int = 0,
    duration: float = 120.0,
    people: int = 2,
    faults: TrackerFaults | None = None,
    rate: float = 10.0,
) -> Tracks:
    """What a tracker reports of a simulated walk.

    With more than two people, `all-forward` has several pairs (the last person of an odd number
    walks alone) and `cross-path` has everybody's way through the middle of the room.

    Args:
        scenario: "all-forward" or "cross-path".
        seed: 0 .. 2**32 - 1. The same arguments give the same bits on the same machine; another
            `duration`, `people` or `rate` gives another walk.
        duration: seconds.
        people: how many.
        faults: of the tracker; None is `TrackerFaults()`.
        rate: frames per second.

    Returns:
        Tracks on the frames `n / rate`, from 0 to `duration`; a person keeps the true id
        0 .. people - 1 until the faults give another one.

    Raises:
        InputError: for an argument out of range.
    """
    return simulate_labelled(scenario, seed, duration, people, faults, rate)[0]


def simulate_labelled(
    scenario: Scenario,
    seed: int = 0,
    duration: float = 120.0,
    people: int = 2,
    faults: TrackerFaults | None = None,
    rate: float = 10.0,
) -> tuple[Tracks, np.ndarray]:
    """`simulate`, with the person whom each row of it belongs to: [R] int64 true ids.

    The label is what an identity score such as IDF1 compares the tracker's ids with.
    """
    faults = TrackerFaults() if faults is None else faults
    path, stamp = _walk(scenario, seed, duration, people, rate)
    lost, label = _tracker(_key(seed, 1), path, faults, rate)
    frame, person = np.nonzero(~lost)
    noise = np.asarray(_normal(_key(seed, 2), path.shape), np.float64)
    seen = path[frame, person] + faults.noise * noise[frame, person]
    ids = label[frame, person]
    tracks = make_tracks(_name(scenario, seed), stamp[frame], ids, seen)
    return tracks, person[np.lexsort((stamp[frame], ids))].astype(np.int64)


def ground_truth(
    scenario: Scenario,
    seed: int = 0,
    duration: float = 120.0,
    people: int = 2,
    rate: float = 10.0,
) -> Tracks:
    """The walk behind `simulate` with the same arguments: no faults, ids 0 .. people - 1."""
    path, stamp = _walk(scenario, seed, duration, people, rate)
    ids = np.repeat(np.arange(people), len(stamp))
    position = path.transpose(1, 0, 2).reshape(-1, 2)
    return make_tracks(_name(scenario, seed), np.tile(stamp, people), ids, position)


def _name(scenario: str, seed: int) -> str:
    return f"synthetic/{scenario}/{seed}"


def _walk(scenario, seed, duration, people, rate) -> tuple[np.ndarray, np.ndarray]:
    """Path [F, P, 2] and stamps [F] in float64."""
    if scenario not in _PLANS:
        raise InputError(f"scenario must be one of {sorted(_PLANS)}, not {scenario!r}")
    if not 0 <= seed < 2**32:
        raise InputError(f"seed must lie in 0 .. 2**32 - 1, not {seed}")
    if people < 1:
        raise InputError(f"people must be at least 1, not {people}")
    if not (0 < rate < float("inf") and 0 <= duration < float("inf")):
        raise InputError(f"rate and duration must be positive, not {rate} and {duration}")
    frames = int(duration * rate + 1e-6) + 1
    path = _walk_frames(_key(seed, 0), scenario, people, frames, float(rate))
    return np.asarray(path, np.float64), np.arange(frames) / rate


def _key(seed: int, purpose: int) -> jax.Array:
    """A key for each purpose of a seed; a Threefry key is two free words, so no need to split."""
    return jax.random.wrap_key_data(jnp.array([purpose, seed], jnp.uint32), impl="threefry2x32")


class _Plan(NamedTuple):
    """What each person means to do on each of L legs; leg 0 is standing at the start."""

    goal: jax.Array  # [L, P, 2] metres
    pause: jax.Array  # [L, P] seconds, after the goal is reached by both of a pair
    pace: jax.Array  # [L, P] metres per second


class _State(NamedTuple):
    position: jax.Array  # [P, 2] metres
    velocity: jax.Array  # [P, 2] metres per second
    heading: jax.Array  # [P] radians
    wobble: jax.Array  # [2, P] in standard deviations, of pace and heading
    leg: jax.Array  # [P] int32
    since: jax.Array  # [P] seconds on this leg
    pause: jax.Array  # [P] seconds still to stand
    arrived: jax.Array  # [P] bool


def _all_forward(chance: jax.Array) -> _Plan:
    """Pairs abreast between the room's ends; a third and fourth pair start a rank behind."""
    legs, people, _ = chance.shape
    pair = np.arange(people) // 2
    lanes = min((people + 1) // 2, 2)
    lane = ((pair % lanes + 0.5) / lanes - 0.5) * 4.0 + ROOM[0] / 2
    side = (np.arange(people) % 2 - 0.5) * ABREAST
    shared = chance[:, 2 * pair]
    x = (lane + side)[None] + _between(shared[..., 0], -0.5, 0.5) / lanes
    short = _between(shared[..., 1], 0.9, 1.5)
    short = short.at[0].add(np.float32(1.8) * (pair // lanes).astype(np.float32))
    far = (np.arange(legs) % 2 == 1)[:, None]
    goal = jnp.stack([x, jnp.where(far, ROOM[1] - short, short)], -1)
    pause = _between(shared[..., 2], 0.1, 1.0) + _between(chance[..., 3], 0.0, 0.2)
    return _Plan(goal + _between(chance[..., 4:6], -0.08, 0.08), pause, _pace(chance))


def _cross_path(chance: jax.Array) -> _Plan:
    """Everybody between two opposite places at the room's edge, so that all ways meet inside."""
    legs, people, _ = chance.shape
    angle = np.pi * (np.arange(people) + 0.5) / people
    way = np.stack([np.cos(angle), np.sin(angle)], -1)
    way /= np.abs(way).max(axis=-1, keepdims=True)
    # Neighbours in angle start from opposite ends: two people meet, they do not merge.
    end = (-1.0) ** (np.arange(legs)[:, None] + np.arange(people) + 1)
    middle = np.array(ROOM) / 2
    station = middle + end[..., None] * way * (middle - [1.0, 1.1])
    goal = station + _between(chance[..., 4:6], -0.4, 0.4)
    return _Plan(goal, _between(chance[..., 3], 0.1, 1.2), _pace(chance))


_PLANS = {"all-forward": _all_forward, "cross-path": _cross_path}


def _pace(chance: jax.Array) -> jax.Array:
    """A speed of one's own, a little less of it on some legs."""
    return _between(chance[:1, :, 6], 1.2, 1.35) * _between(chance[..., 7], 0.92, 1.0)


def _between(chance: jax.Array, low: float, high: float) -> jax.Array:
    return low + (high - low) * chance


@functools.partial(jax.jit, static_argnames=("scenario", "people", "frames", "rate"))
def _walk_frames(key: jax.Array, scenario: str, people: int, frames: int, rate: float) -> jax.Array:
    """Positions [frames, people, 2] in metres; `key` is consumed."""
    substeps = int(np.ceil(1 / (rate * MAX_STEP) - 1e-9))
    dt = 1 / (rate * substeps)
    # No leg takes less than two seconds: the shortest way across is 3 m.
    legs = int(frames / rate / 2) + 3
    # One draw for everything, because each costs a third of a second to compile. float32 by name,
    # so that the same seed is the same walk under x64. A kick of unit variance need not be normal:
    # the wobble is the sum of many.
    steps = frames * substeps + 1
    plans = legs * people * 8
    chance = jax.random.uniform(key, (plans + steps * 2 * people,), jnp.float32)
    kicks = float(np.sqrt(12)) * (chance[plans:].reshape(steps, 2, people) - 0.5)
    chance = chance[:plans].reshape(legs, people, 8)
    plan = _PLANS[scenario](chance)
    plan = jax.tree.map(lambda array: array.astype(jnp.float32), plan)
    zeros = jnp.zeros(people, jnp.float32)
    ahead = plan.goal[1] - plan.goal[0]
    start = _State(
        position=plan.goal[0],
        velocity=jnp.zeros((people, 2), jnp.float32),
        heading=jnp.arctan2(ahead[:, 1], ahead[:, 0]),
        wobble=kicks[0],
        leg=jnp.zeros(people, jnp.int32),
        since=zeros,
        pause=plan.pause[0],
        arrived=jnp.ones(people, bool),
    )
    abreast = scenario == "all-forward"

    def step(state, kick):
        return _step(plan, abreast, dt, state, kick), state.position

    _, path = jax.lax.scan(step, start, kicks[1:])
    return path[::substeps]


def _step(plan: _Plan, abreast: bool, dt: float, state: _State, kick: jax.Array) -> _State:
    """One Euler step of everybody."""
    people = len(state.leg)
    partner = np.arange(people) ^ 1
    partner = np.where(partner < people, partner, np.arange(people))
    everyone = np.arange(people)

    # Turn around together: stand until one's partner has arrived too, then pause.
    goal = plan.goal[state.leg, everyone]
    there = _length(goal - state.position) < ARRIVED
    arrived = state.arrived | there | (state.since > PATIENCE)
    ready = arrived & (arrived[partner] | (state.leg[partner] > state.leg))
    pause = jnp.where(ready, state.pause - dt, state.pause)
    depart = ready & (pause <= 0)
    leg = jnp.minimum(state.leg + depart, len(plan.goal) - 1)
    arrived = arrived & ~depart
    goal = plan.goal[leg, everyone]
    pause = jnp.where(depart, plan.pause[leg, everyone], pause)
    since = jnp.where(depart, 0.0, state.since + dt)

    way = goal - state.position
    error = jnp.arctan2(way[:, 1], way[:, 0]) - state.heading
    error = jnp.arctan2(jnp.sin(error), jnp.cos(error))
    heading = state.heading + jnp.where(
        arrived, 0.0, jnp.clip(error, -TURN_RATE * dt, TURN_RATE * dt)
    )
    keep = float(np.exp(-dt / WOBBLE_TIME))
    wobble = keep * state.wobble + float(np.sqrt(1 - keep**2)) * kick
    top = plan.pace[leg, everyone]
    pace = top * (1 + WOBBLE[0] * wobble[0]) * jnp.clip(_length(way) / BRAKING, 0.3, 1.0)
    pace = jnp.where(arrived, 0.0, pace * (0.25 + 0.75 * jnp.clip(jnp.cos(error), 0.0, 1.0)))
    aim = heading + WOBBLE[1] * wobble[1]
    desired = pace[:, None] * jnp.stack([jnp.cos(aim), jnp.sin(aim)], -1)

    force = (desired - state.velocity) / RELAXATION + _walls(state.position)
    others = ~np.eye(people, dtype=bool)
    apart = state.position[:, None] - state.position[None]
    near = _length(apart)[..., None]
    force = force + jnp.sum(CONTACT * jnp.maximum(TOUCH - near, 0.0) * apart / near, axis=1)
    if abreast:
        others[everyone, partner] = False
        rank = np.stack([(everyone - partner) * ABREAST, np.zeros(people)], -1).astype(np.float32)
        gap = state.position - state.position[partner]
        drift = state.velocity - state.velocity[partner]
        force = force + SPRING / 2 * (rank - gap) - DAMPING / 2 * drift
    from_all = jax.vmap(_repulsion, (None, 0, None, None, 0))
    push = jax.vmap(from_all, (0, None, 0, 0, None))(
        state.position, state.position, heading, state.velocity, state.velocity
    )
    force = force + jnp.sum(jnp.where(others[..., None], push, 0.0), axis=1)

    velocity = state.velocity + dt * force
    limit = TOP_SPEED * top / jnp.maximum(_length(velocity), TOP_SPEED * top)
    velocity = velocity * limit[:, None]
    position = state.position + dt * velocity
    inside = jnp.clip(position, MARGIN, np.array([ROOM], np.float32) - MARGIN)
    velocity = jnp.where(position == inside, velocity, 0.0)
    return _State(inside, velocity, heading, wobble, leg, since, pause, arrived)


def _repulsion(
    own: jax.Array,
    other: jax.Array,
    heading: jax.Array,
    own_velocity: jax.Array,
    velocity: jax.Array,
) -> jax.Array:
    """Acceleration [2] of the person at `own` by the one at `other`: Helbing-Molnár (3), (4)."""

    def potential(offset):
        stride = (velocity - own_velocity) * ANTICIPATION
        major = _length(offset) + _length(offset - stride)
        minor = 0.5 * jnp.sqrt(jnp.maximum(major**2 - stride @ stride, 1e-4))
        return REPULSION * jnp.exp((BODY - minor) / RANGE)

    offset = own - other
    push = -jax.grad(potential)(offset)
    ahead = -(offset @ jnp.stack([jnp.cos(heading), jnp.sin(heading)]))
    seen = ahead >= _length(offset) * float(np.cos(HALF_VIEW))
    return jnp.where(seen, 1.0, BEHIND) * push


def _walls(position: jax.Array) -> jax.Array:
    """Acceleration [P, 2] away from the four walls."""

    def push(distance):
        return WALL / WALL_RANGE * jnp.exp(-distance / WALL_RANGE)

    return push(position) - push(np.array([ROOM], np.float32) - position)


def _length(vector: jax.Array) -> jax.Array:
    """Euclidean length over the last axis; smooth at zero, for its gradient is a force."""
    return jnp.sqrt(jnp.sum(vector * vector, axis=-1) + 1e-8)


@functools.partial(jax.jit, static_argnames="shape")
def _normal(key: jax.Array, shape: tuple[int, ...]) -> jax.Array:
    return jax.random.normal(key, shape, jnp.float32)


@functools.partial(jax.jit, static_argnames="shape")
def _uniform(key: jax.Array, shape: tuple[int, ...]) -> jax.Array:
    return jax.random.uniform(key, shape, jnp.float32)


def _tracker(
    key: jax.Array, path: np.ndarray, faults: TrackerFaults, rate: float
) -> tuple[np.ndarray, np.ndarray]:
    """Who is lost, [F, P] bool, and the tracker's id for everybody, [F, P] int64."""
    frames, people, _ = path.shape
    if faults.dropout == faults.id_swap == 0:
        return np.zeros((frames, people), bool), np.tile(np.arange(people), (frames, 1))
    chance = np.asarray(_uniform(key, (frames, people, 3 + people)), np.float64)
    frame = np.arange(frames)[:, None]
    # Geometric length by inversion: P(more than n frames) = (1 - 1 / mean) ** n.
    mean = max(faults.dropout_seconds * rate, 1.0)
    tail = np.log1p(-1 / mean) if mean > 1 else -np.inf
    survive = np.log1p(-chance[..., 1])
    length = 1 + np.floor(survive / tail)
    begins = chance[..., 0] < faults.dropout
    lost = np.maximum.accumulate(np.where(begins, frame + length, 0.0), axis=0) > frame

    back = np.zeros((frames, people), bool)
    back[1:] = lost[:-1] & ~lost[1:] & np.logical_or.accumulate(~lost, axis=0)[:-1]
    renamed = back & (chance[..., 2] < faults.id_switch)
    fresh = people - 1 + np.cumsum(renamed).reshape(renamed.shape)
    label = np.maximum.accumulate(np.where(renamed, fresh, np.arange(people)), axis=0)

    between = np.linalg.norm(path[:, :, None] - path[:, None], axis=-1)
    close = (between < SWAP_DISTANCE) & ~lost[:, :, None] & ~lost[:, None]
    swaps = np.triu(close & (chance[..., 3:] < faults.id_swap), 1)
    for at, one, two in np.argwhere(swaps):
        label[at:, [one, two]] = label[at:, [two, one]]
    return lost, label
