"""People walking in a room: a social-force model, integrated in `lax.scan`.

The forces are those of D. Helbing and P. Molnár, "Social force model for pedestrian
dynamics", Phys. Rev. E 51, 4282 (1995): relaxation to a desired velocity, elliptical
exponential repulsion between people (half effect out of view), repulsion from walls,
limited speed. The ellipse follows the relative velocity, as in A. Johansson, D. Helbing
and P. Shukla, Adv. Complex Syst. 10, 271 (2007): with the other's velocity alone,
people in a room this small jump back.

Our assumptions: anticipation of 1 s, bodies and contact, a softer wall, a limited
turning rate, braking before the goal and pausing there for the partner, slow random
changes of pace and heading, and, in place of an attraction, a spring that keeps a pair
0.8 m abreast.
"""

import functools
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

__all__ = ["ABREAST", "Plan", "walk"]

RELAXATION = 0.5  # s
REPULSION, RANGE = 2.1, 0.3  # m^2/s^2, m
# s of coming relative motion; 2 s in 1995, for walks longer than a room
ANTICIPATION = 1.0
BODY = 0.2  # m, taken off a distance before the repulsion is evaluated
BEHIND = 0.5  # of the repulsion by people out of view
HALF_VIEW = np.deg2rad(100.0)
WALL, WALL_RANGE = 1.0, 0.2  # m^2/s^2, m
CONTACT, TOUCH = 30.0, 0.5  # 1/s^2, m: people nearer than this, a pair too, push apart
MARGIN = 0.25  # m; no centre of a person comes nearer to a wall
TOP_SPEED, TURN_RATE = 1.3, 2.5  # of the desired speed, rad/s
ABREAST = 0.8  # m between the two of a pair
SPRING, DAMPING = 2.0, 1.0  # 1/s^2, 1/s: of a pair
BRAKING, ARRIVED = 0.8, 0.3  # m from the goal
PATIENCE = 15.0  # s on one leg, after which a blocked person counts as arrived
WOBBLE = (0.06, 0.10)  # standard deviations of relative pace and of heading (rad)
WOBBLE_TIME = 1.5  # s


class Plan(NamedTuple):
    """Goals of P people on each of L legs; leg 0 is standing at the start."""

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


def walk(
    plan: Plan, kicks: jax.Array, dt: float, room: tuple[float, float], abreast: bool
) -> jax.Array:
    """Positions [F, P, 2] in metres, a frame every `dt` (at most 0.05) seconds, from leg 0 on.

    `kicks` [F + 1, 2, P] of unit variance change pace and heading at random. With
    `abreast`, people 0 and 1, 2 and 3, ... are pairs that stay side by side across x.
    """
    people = plan.goal.shape[1]
    ahead = plan.goal[1] - plan.goal[0]
    start = _State(
        position=plan.goal[0],
        velocity=jnp.zeros((people, 2), jnp.float32),
        heading=jnp.arctan2(ahead[:, 1], ahead[:, 0]),
        wobble=kicks[0],
        leg=jnp.zeros(people, jnp.int32),
        since=jnp.zeros(people, jnp.float32),
        pause=plan.pause[0],
        arrived=jnp.ones(people, bool),
    )
    step = functools.partial(_step, plan, abreast, dt, room)
    _, positions = jax.lax.scan(step, start, kicks[1:])
    return positions


def _step(
    plan: Plan,
    abreast: bool,
    dt: float,
    room: tuple[float, float],
    state: _State,
    kick: jax.Array,
) -> tuple[_State, jax.Array]:
    """One Euler step of all people: the next state, and the positions [P, 2] of this one."""
    following = _on_legs(plan, dt, state)
    people = np.arange(len(state.leg))
    way = plan.goal[following.leg, people] - state.position
    top = plan.pace[following.leg, people]

    bearing = jnp.arctan2(way[:, 1], way[:, 0])
    error = bearing - state.heading
    error = jnp.arctan2(jnp.sin(error), jnp.cos(error))
    turn = jnp.clip(error, -TURN_RATE * dt, TURN_RATE * dt)
    heading = state.heading + jnp.where(following.arrived, 0.0, turn)
    keep = float(np.exp(-dt / WOBBLE_TIME))
    renew = float(np.sqrt(1 - keep**2))
    wobble = keep * state.wobble + renew * kick
    pace_wobble, heading_wobble = WOBBLE

    braking = jnp.clip(_length(way) / BRAKING, 0.3, 1.0)
    pace = top * (1 + pace_wobble * wobble[0]) * braking
    facing = jnp.clip(jnp.cos(error), 0.0, 1.0)
    turning = 0.25 + 0.75 * facing
    pace = jnp.where(following.arrived, 0.0, pace * turning)
    aim = heading + heading_wobble * wobble[1]
    direction = jnp.stack([jnp.cos(aim), jnp.sin(aim)], -1)
    desired = pace[:, None] * direction
    force = (desired - state.velocity) / RELAXATION
    force = force + _walls(state.position, room)
    force = _with_others(force, state, heading, abreast)

    velocity = state.velocity + dt * force
    limit = TOP_SPEED * top
    slower = limit / jnp.maximum(_length(velocity), limit)
    velocity = velocity * slower[:, None]
    position = state.position + dt * velocity
    corner = np.array([room], np.float32) - MARGIN
    inside = jnp.clip(position, MARGIN, corner)
    velocity = jnp.where(position == inside, velocity, 0.0)
    following = following._replace(
        position=inside, velocity=velocity, heading=heading, wobble=wobble
    )
    return following, state.position


def _on_legs(plan: Plan, dt: float, state: _State) -> _State:
    """The state with people who have paused at their goals on their next legs.

    Partners turn around together: they stand until both have arrived, then pause.
    """
    people = np.arange(len(state.leg))
    partner = _partners(people)
    goal = plan.goal[state.leg, people]
    at_goal = _length(goal - state.position) < ARRIVED
    arrived = state.arrived | at_goal | (state.since > PATIENCE)
    is_ahead = state.leg[partner] > state.leg
    ready = arrived & (arrived[partner] | is_ahead)
    pause = jnp.where(ready, state.pause - dt, state.pause)
    depart = ready & (pause <= 0)
    leg = jnp.minimum(state.leg + depart, len(plan.goal) - 1)
    return state._replace(
        leg=leg,
        since=jnp.where(depart, 0.0, state.since + dt),
        pause=jnp.where(depart, plan.pause[leg, people], pause),
        arrived=arrived & ~depart,
    )


def _partners(people: np.ndarray) -> np.ndarray:
    """[P] the other of each pair of 0 and 1, 2 and 3, ...; the last of an odd number has none."""
    partner = people ^ 1
    return np.where(partner < len(people), partner, people)


def _with_others(
    force: jax.Array, state: _State, heading: jax.Array, abreast: bool
) -> jax.Array:
    """`force [P, 2]` with the contact, the springs of pairs, and the repulsion by others."""
    people = np.arange(len(state.leg))
    others = ~np.eye(len(people), dtype=bool)
    offset = state.position[:, None] - state.position[None]
    distance = _length(offset)[..., None]
    contact = CONTACT * jnp.maximum(TOUCH - distance, 0.0) * offset / distance
    force = force + jnp.sum(contact, axis=1)
    if abreast:
        partner = _partners(people)
        others[people, partner] = False
        rank = ABREAST * np.stack([people - partner, 0 * people], -1)
        gap = state.position - state.position[partner]
        drift = state.velocity - state.velocity[partner]
        spring = SPRING / 2 * (rank.astype(np.float32) - gap)
        force = force + spring - DAMPING / 2 * drift
    from_others = jax.vmap(_repulsion, (None, 0, None, None, 0))
    repulsions = jax.vmap(from_others, (0, None, 0, 0, None))
    push = repulsions(
        state.position, state.position, heading, state.velocity, state.velocity
    )
    push = jnp.where(others[..., None], push, 0.0)
    return force + jnp.sum(push, axis=1)


def _repulsion(own, other, heading, own_velocity, velocity) -> jax.Array:
    """Acceleration [2] of the person at `own` by the one at `other`: Helbing-Molnár (3), (4)."""

    def potential(offset):
        stride = (velocity - own_velocity) * ANTICIPATION
        major = _length(offset) + _length(offset - stride)
        square = major**2 - stride @ stride
        minor = 0.5 * jnp.sqrt(jnp.maximum(square, 1e-4))
        return REPULSION * jnp.exp((BODY - minor) / RANGE)

    offset = own - other
    push = -jax.grad(potential)(offset)
    direction = jnp.stack([jnp.cos(heading), jnp.sin(heading)])
    ahead = -(offset @ direction)
    seen = ahead >= _length(offset) * float(np.cos(HALF_VIEW))
    return jnp.where(seen, 1.0, BEHIND) * push


def _walls(position: jax.Array, room: tuple[float, float]) -> jax.Array:
    """Acceleration [P, 2] away from the four walls."""

    def push(distance: jax.Array | np.ndarray) -> jax.Array:
        return WALL / WALL_RANGE * jnp.exp(-distance / WALL_RANGE)

    near = push(position)
    far = push(np.array([room], np.float32) - position)
    return near - far


def _length(vector: jax.Array) -> jax.Array:
    """Euclidean length over the last axis; smooth at zero, for its gradient is a force."""
    square = jnp.sum(vector * vector, axis=-1)
    return jnp.sqrt(square + 1e-8)
