"""Tracking errors: steps that contradict the steps around them, and what replaces them.

A step is an error because it is inconsistent, not because it is fast. Consecutive steps
whose velocity changes by no more than `TOP_CHANGE` (somewhat more of a fast agent)
belong together. The run of steps around the track's typical step is believed where
enough steps agree with it, at any speed up to `FASTEST`, and it says how fast the agent
can be: a step is an error beyond that, or where it differs both from the steps beside
it and from the typical one.

A position between two such steps is interpolated if that mends both; another such step
is replaced by the last plausible one before it, or the first one after it. A jump at
the last step is not confirmed by a later position: neighbours see the agent where it
would be without it, and its own forecast begins at the reported position. Of an agent
without any plausible step nothing is known but the position, and its forecast is as
wide as what people do, see `unknown_motion`.

Nothing here is applied to networks of SGAN and NeuroSyM unless it is asked for.
"""

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

if TYPE_CHECKING:
    from jax import Array

    from neurosym_jax.scene import AnyArray, Scene

__all__ = [
    "FAST",
    "FASTEST",
    "TOP_CHANGE",
    "TOP_SPEED",
    "Repair",
    "expansion_of",
    "limit_displacement",
    "repair_scene",
    "repair_tracks",
    "settle",
    "unknown_motion",
    "was_repaired",
]

FAST = 3.0
"""Speed beyond which an agent's own motion is scaled down to it for a network, m/s: networks
learn from people who walk."""
TOP_SPEED = 4.0
"""Speed that a step may have whatever the others are, m/s: a fast run."""
FASTEST = 20.0
"""Largest speed of anybody under their own power, m/s: a bicycle downhill. Pixels are faster."""
TOP_CHANGE = 1.8
"""Largest change of velocity from one step to the next, m/s: a fast walk to a stand."""
CHANGE_SHARE, FAST_CHANGE = 0.3, 2.4
"""The same of the fast, a share of the typical speed up to 2.4 m/s: a cyclist who brakes or turns
hard. An error of 1 m changes the velocity by 2.5 m/s at a step of 0.4 s."""
HEADROOM = 1.5
"""How much faster than the believed steps another step may be."""
WITNESSES = 3
"""Steps that must agree for a speed beyond `TOP_SPEED`, or most of fewer steps."""
STRIDE = 2.0
"""Largest speed in `unknown_motion`, m/s: a fast walk."""
GOLDEN_ANGLE = np.pi * (3 - np.sqrt(5))
"""Angle between consecutive points of a sunflower, radians."""


class Repair(NamedTuple):
    """Plausible tracks of N agents, and what is known of the reported ones."""

    tracks: Any
    """[N, T, 2] metres."""
    offset: Any
    """[N, 2] metres from the last position of `tracks` to the reported one; 0 unless the last
    step is an error."""
    lost: Any
    """[N] bool, no step is plausible: the track stands, and nothing is known of its motion."""


def repair_tracks(observed: "AnyArray", period: float) -> Repair:
    """Replace the steps of `observed [N, T, 2]` that are tracking errors, see the module.

    Args:
        observed: [N, T, 2] metres, numpy's or jax's; so are the results.
        period: of a step, seconds.
    """
    xp = _numpy_of(observed)
    steps = xp.diff(observed, axis=1)
    wrong, bridge, bridged = _errors(xp, steps, period)

    # A bridge replaces the step before it and the one after it.
    none = xp.zeros_like(wrong[:, :1])
    nowhere = xp.zeros_like(steps[:, :1])
    begins = xp.concatenate([bridged, none], 1)
    ends = xp.concatenate([none, bridged], 1)
    bridge_before = xp.concatenate([nowhere, bridge], 1)
    bridge_after = xp.concatenate([bridge, nowhere], 1)
    step = xp.where(ends[..., None], bridge_before, steps)
    step = xp.where(begins[..., None], bridge_after, step)
    plausible = ~wrong | begins | ends

    # Each becomes the last plausible step up to it, or else the first one after it.
    number = np.arange(steps.shape[1], dtype=np.int32)
    up_to = number <= number[:, None]
    is_source = plausible[:, None] & up_to[None]
    source = xp.where(is_source, number[None, None], -1).max(2)
    first = xp.where(plausible, number[None], number[-1]).min(1)[:, None]
    source = xp.where(source < 0, first, source)
    mended = xp.take_along_axis(step, source[..., None], axis=1)
    lost = ~plausible.any(1)
    mended = xp.where(lost[:, None, None], 0, mended)

    jump = steps[:, -1] - mended[:, -1]
    offset = xp.where(plausible[:, -1:], 0, jump)
    last = (observed[:, -1] - offset)[:, None]
    # The way from each position to the last.
    backwards = mended[:, ::-1]
    way = xp.cumsum(backwards, axis=1)[:, ::-1]
    points = xp.concatenate([last - way, last], 1)
    # A track without errors keeps its bits.
    has_errors = wrong.any(1)[:, None, None]
    tracks = xp.where(has_errors, points, observed)
    return Repair(tracks, offset, lost)


def _numpy_of(array: Any) -> Any:
    """numpy, or JAX's for its arrays: streams are read without JAX."""
    if isinstance(array, np.ndarray):
        return np
    import jax.numpy as jnp

    return jnp


def _beyond(vectors: Any, speed: Any, period: float) -> Any:
    """Whether steps `vectors [..., 2]` are faster than `speed`, m/s."""
    limit = speed * period
    return _square(vectors) > limit * limit


def _square(vectors: Any) -> Any:
    """[...] square lengths of `vectors [..., 2]`; a CPU's sum over an axis of two is slow."""
    x, y = vectors[..., 0], vectors[..., 1]
    return x * x + y * y


def _errors(xp: Any, steps: Any, period: float) -> tuple[Any, Any, Any]:
    """Which of `steps [N, S, 2]` are errors `[N, S]`, and what bridges two of them.

    The bridge `[N, S - 1, 2]` is the mean of two consecutive steps; it replaces them
    where `[N, S - 1]` says so.
    """
    # The step that differs least from all others.
    total: Any = 0
    for number in range(steps.shape[1]):
        difference = steps - steps[:, number : number + 1]
        total = total + xp.sqrt(_square(difference) + 1e-6)
    middle = total.argmin(1)[:, None]
    typical = xp.take_along_axis(steps, middle[..., None], axis=1)
    typical_speed = xp.sqrt(_square(typical)) / period  # [N, 1]
    change = xp.clip(CHANGE_SHARE * typical_speed, TOP_CHANGE, FAST_CHANGE)

    following = steps[:, 1:] - steps[:, :-1]
    turn = _beyond(following, change, period)
    end = xp.ones_like(middle, bool)
    turn_before = xp.concatenate([end, turn], 1)
    turn_after = xp.concatenate([turn, end], 1)
    unlike = _beyond(steps - typical, change, period)

    # The run of steps around the typical one, and whether enough agree with it.
    begins = xp.concatenate([~end, turn], 1)
    run = xp.cumsum(begins.astype(np.int32), axis=1)
    main = run == xp.take_along_axis(run, middle, axis=1)
    witnesses = (main | ~unlike).sum(1)
    believed = witnesses >= min(WITNESSES, steps.shape[1] // 2 + 1)

    square = xp.where(main, _square(steps), 0)
    reached = xp.sqrt(square.max(1)) / period
    limit = xp.maximum(HEADROOM * reached, TOP_SPEED)
    limit = xp.where(believed, limit, TOP_SPEED)
    limit = xp.minimum(limit, FASTEST)[:, None]

    sudden = turn_before & turn_after & unlike
    # Where too few steps agree, none is a witness.
    wrong = _beyond(steps, limit, period) | sudden | ~believed[:, None]
    bridge = (steps[:, 1:] + steps[:, :-1]) / 2
    is_slow = ~_beyond(bridge, limit, period)
    is_like = ~_beyond(bridge - typical, change, period)
    both = wrong[:, 1:] & wrong[:, :-1]
    return wrong, bridge, both & (is_slow & is_like)


def repair_scene(scene: "Scene", period: float) -> "tuple[Scene, Repair]":
    """The scene with plausible tracks, and what was repaired, see `repair_tracks`."""
    import jax.numpy as jnp

    from neurosym_jax.scene import moves_of

    repair = repair_tracks(jnp.asarray(scene.observed), period)
    track = repair.tracks
    changed = (track != scene.observed).any((1, 2))
    steps = jnp.where(changed[:, None, None], moves_of(track), scene.displacement)
    return scene.replace(observed=track, displacement=steps), repair


def was_repaired(observed: np.ndarray, period: float) -> np.ndarray:
    """[N] bool, which of the tracks `observed [N, T, 2]` metres have tracking errors."""
    steps = np.diff(observed, axis=1)
    turns = _beyond(np.diff(steps, axis=1), TOP_CHANGE, period).any(axis=1)
    # Steps that all agree are errors only where nobody is as fast; most tracks are such.
    too_fast = _beyond(steps, FASTEST, period).any(axis=1)
    repaired = np.asarray(turns | too_fast)
    if repaired.any():
        group = observed[repaired]
        repair = repair_tracks(group, period)
        changed = (repair.tracks != group).any((1, 2))
        repaired[repaired] = changed | repair.offset.any(1) | repair.lost
    return repaired


def settle(forecast: Any, repair: Repair, period: float) -> Any:
    """`forecast [k, N, T, 2]` of the repaired tracks, from the reported positions.

    Of agents without a plausible step it becomes `unknown_motion`.
    """
    xp = _numpy_of(forecast)
    last = repair.tracks[None, :, -1, None]
    unknown = unknown_motion(len(forecast), forecast.shape[2], period)
    unknown = xp.asarray(unknown, forecast.dtype)[:, None] + last
    forecast = xp.where(repair.lost[None, :, None, None], unknown, forecast)
    return forecast + repair.offset[None, :, None]


def expansion_of(steps: "Array", period: float) -> "Array":
    """[N] factors, 1 or more, by which agents move faster than `FAST`, by their fastest step.

    A network sees an agent's own motion divided by its factor, and its residual is
    multiplied by it. `steps [N, S, 2]` are plausible ones in metres.
    """
    import jax.numpy as jnp

    fastest = jnp.sqrt(_square(steps).max(1) + 1e-12)
    return jnp.maximum(fastest / (FAST * period), 1)


def unknown_motion(count: int, steps: int, period: float) -> np.ndarray:
    """[count, steps, 2] metres of equally probable futures of whom nothing is known.

    They leave in all directions, at speeds from 0 to `STRIDE` that are equally
    frequent.
    """
    number = np.arange(count)
    angle = GOLDEN_ANGLE * number
    direction = np.stack([np.cos(angle), np.sin(angle)], -1)
    speed = STRIDE * (number + 0.5) / count
    velocity = speed[:, None] * direction
    time = period * np.arange(1, steps + 1)
    return velocity[:, None] * time[:, None]


def limit_displacement(ahead: "Array", period: float, expansion: "Array") -> "Array":
    """Displacements from the last position, pulled smoothly within what an agent can reach.

    That is `TOP_SPEED`, or a third more than its fastest step. Displacements of up to
    half of that are changed by less than 0.1 %.

    Args:
        ahead: [2, T, k, N] metres.
        period: of a step, seconds.
        expansion: [N] of the agents, see `expansion_of`.

    Returns:
        [2, T, k, N] metres.
    """
    import jax
    import jax.numpy as jnp

    time = period * jnp.arange(1, ahead.shape[1] + 1, dtype=ahead.dtype)
    # Smooth, so that 0 has a gradient.
    distance = jnp.sqrt(jnp.square(ahead).sum(0) + 1e-6)
    reach = TOP_SPEED * expansion[None, None] * time[:, None, None] + 0.3
    share = distance / reach
    # (1 + share^8)^(-1/8), written so that a large share does not overflow.
    low = jnp.minimum(share, 1)
    high = jnp.maximum(share, 1)
    power = high**-8 + low**8
    factor = jax.lax.rsqrt(jnp.sqrt(jnp.sqrt(power))) / high
    return factor[None] * ahead
