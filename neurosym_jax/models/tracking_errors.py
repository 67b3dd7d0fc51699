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

    mended: list[Any] = []
    last_mended: Any = 0
    plausible = xp.zeros_like(wrong[:, 0])
    for number in range(steps.shape[1]):
        step = steps[:, number]
        plausible_step = ~wrong[:, number]
        for pair in (number - 1, number):
            if 0 <= pair < bridged.shape[1]:
                is_bridged = bridged[:, pair]
                step = xp.where(is_bridged[:, None], bridge[:, pair], step)
                plausible_step = plausible_step | is_bridged
        # Earlier steps without a plausible one before them become the first one after
        # them.
        is_first = (plausible_step & ~plausible)[:, None]
        mended = [xp.where(is_first, step, before) for before in mended]
        if mended:
            last_mended = mended[-1]
        mended.append(xp.where(plausible_step[:, None], step, last_mended))
        plausible = plausible | plausible_step

    jump = steps[:, -1] - mended[-1]
    offset = xp.where(plausible_step[:, None], 0, jump)
    points = [observed[:, -1] - offset]
    for step in reversed(mended):
        points.append(points[-1] - step)
    # A track without errors keeps its bits.
    has_errors = wrong.any(1)[:, None, None]
    tracks = xp.where(has_errors, xp.stack(points[::-1], 1), observed)
    return Repair(tracks, offset, ~plausible)


def _numpy_of(array: Any) -> Any:
    """numpy, or JAX's for its arrays: streams are read without JAX."""
    if isinstance(array, np.ndarray):
        return np
    import jax.numpy as jnp

    return jnp


def _beyond(vectors: Any, speed: Any, period: float) -> Any:
    """Whether steps `vectors [..., 2]` are faster than `speed`, m/s."""
    limit = speed * period
    return (vectors * vectors).sum(-1) > limit * limit


def _errors(xp: Any, steps: Any, period: float) -> tuple[Any, Any, Any]:
    """Which of `steps [N, S, 2]` are errors `[N, S]`, and what bridges two of them.

    The bridge `[N, S - 1, 2]` is the mean of two consecutive steps; it replaces them
    where `[N, S - 1]` says so.
    """
    # The step that differs least from all others.
    difference = steps[:, :, None] - steps[:, None]
    difference = xp.sqrt(xp.square(difference).sum(-1) + 1e-6)
    middle = difference.sum(2).argmin(1)[:, None]
    typical = xp.take_along_axis(steps, middle[..., None], axis=1)
    typical_speed = xp.sqrt(xp.square(typical).sum(-1)) / period  # [N, 1]
    change = xp.clip(CHANGE_SHARE * typical_speed, TOP_CHANGE, FAST_CHANGE)

    turn = _beyond(steps[:, 1:] - steps[:, :-1], change, period)
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

    square = xp.where(main, xp.square(steps).sum(-1), 0)
    reached = xp.sqrt(square.max(1)) / period
    limit = xp.maximum(HEADROOM * reached, TOP_SPEED)
    limit = xp.where(believed, limit, TOP_SPEED)
    limit = xp.minimum(limit, FASTEST)[:, None]

    sudden = turn_before & turn_after & unlike
    # Where too few steps agree, none is a witness.
    wrong = _beyond(steps, limit, period) | sudden | ~believed[:, None]
    bridge = (steps[:, 1:] + steps[:, :-1]) / 2
    mends = ~_beyond(bridge, limit, period) & ~_beyond(bridge - typical, change, period)
    return wrong, bridge, wrong[:, 1:] & wrong[:, :-1] & mends


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
    repaired = np.asarray(turns | _beyond(steps, FASTEST, period).any(axis=1))
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

    fastest = jnp.sqrt(jnp.square(steps).sum(-1).max(1) + 1e-12)
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


def limit_displacement(
    forecast: "Array", last: "Array", period: float, expansion: "Array"
) -> "Array":
    """Forecast positions pulled smoothly within what an agent can reach.

    That is `TOP_SPEED`, or a third more than its fastest step. Displacements of up to
    half of that are changed by less than 0.1 %.

    Args:
        forecast: [k, N, T, 2] metres.
        last: [N, 2] last observed positions, metres.
        period: of a step, seconds.
        expansion: [N] of the agents, see `expansion_of`.

    Returns:
        [k, N, T, 2] metres.
    """
    import jax.numpy as jnp

    time = period * jnp.arange(1, forecast.shape[2] + 1, dtype=forecast.dtype)
    start = last[None, :, None]
    ahead = forecast - start
    # Smooth, so that 0 has a gradient.
    distance = jnp.sqrt(jnp.square(ahead).sum(-1) + 1e-6)
    reach = TOP_SPEED * expansion[:, None] * time[None] + 0.3
    share = distance / reach[None]
    # (1 + share^8)^(-1/8), written so that a large share does not overflow.
    low = jnp.minimum(share, 1)
    high = jnp.maximum(share, 1)
    factor = (high**-8 + low**8) ** (-1 / 8) / high
    return start + factor[..., None] * ahead
