"""Positions that no person can have reached: how a network sees a track with tracking errors.

A step is an error beyond `TOP_SPEED`, or where its velocity differs by more than
`TOP_CHANGE` from that of the steps beside it and of the track's typical step. A
position between two such steps is interpolated if that mends both; another such step is
replaced by the last plausible one before it, or the first one after it. A jump at the
last step is not confirmed by a later position: neighbours see the agent where it would
be without it, and its own forecast begins at the reported position.
"""

from typing import Any

import jax.numpy as jnp
import numpy as np
from jax import Array

from neurosym_jax.scene import AnyArray, Scene

__all__ = [
    "TOP_CHANGE",
    "TOP_SPEED",
    "limit_displacement",
    "repair_scene",
    "repair_tracks",
]

TOP_SPEED = 4.0
"""Largest speed that models take for a person's, m/s: a fast run."""
TOP_CHANGE = 1.8
"""Largest change of velocity from one step to the next, m/s: a fast walk to a stand."""


def repair_tracks(observed: AnyArray, period: float) -> tuple[Any, Any]:
    """Plausible tracks, and how far the reported last positions lie from theirs.

    Args:
        observed: [N, T, 2] metres, numpy's or jax's; so are the results.
        period: of a step, seconds.

    Returns:
        Tracks [N, T, 2] and offsets [N, 2] in metres, zero unless the last step is an
        error.
    """
    xp: Any = np if isinstance(observed, np.ndarray) else jnp

    def beyond(steps: Any, speed: float) -> Any:
        return xp.square(steps).sum(-1) > (speed * period) ** 2

    steps = xp.diff(observed, axis=1)
    difference = xp.sqrt(xp.square(steps[:, :, None] - steps[:, None]).sum(-1) + 1e-6)
    typical = xp.take_along_axis(
        steps, difference.sum(2).argmin(1)[:, None, None], axis=1
    )
    turn = beyond(steps[:, 1:] - steps[:, :-1], TOP_CHANGE)
    end = xp.ones_like(turn[:, :1])
    sudden = xp.concatenate([end, turn], 1) & xp.concatenate([turn, end], 1)
    wrong = beyond(steps, TOP_SPEED) | (sudden & beyond(steps - typical, TOP_CHANGE))

    bridge = (steps[:, 1:] + steps[:, :-1]) / 2
    bridged = wrong[:, 1:] & wrong[:, :-1] & ~beyond(bridge, TOP_SPEED)
    bridged &= ~beyond(bridge - typical, TOP_CHANGE)
    mended: list[Any] = []
    plausible = xp.zeros_like(wrong[:, 0])
    for number in range(steps.shape[1]):
        step, plausible_step = steps[:, number], ~wrong[:, number]
        for pair in (number - 1, number):
            if 0 <= pair < bridged.shape[1]:
                step = xp.where(bridged[:, pair, None], bridge[:, pair], step)
                plausible_step = plausible_step | bridged[:, pair]
        # Of earlier steps without a plausible one before them, this is the first one
        # after them.
        mended = [
            xp.where((plausible_step & ~plausible)[:, None], step, before)
            for before in mended
        ]
        mended += [xp.where(plausible_step[:, None], step, mended[-1] if mended else 0)]
        plausible = plausible | plausible_step

    offset = xp.where(plausible_step[:, None], 0, steps[:, -1] - mended[-1])
    last = observed[:, -1] - offset
    track = [last]
    for step in mended[::-1]:
        track.insert(0, track[0] - step)
    # A track without errors keeps its bits.
    return xp.where(wrong.any(1)[:, None, None], xp.stack(track, 1), observed), offset


def repair_scene(scene: Scene, period: float) -> tuple[Scene, Array]:
    """The scene with plausible tracks, and offsets [N, 2] of its forecast, see `repair_tracks`."""
    track, offset = repair_tracks(jnp.asarray(scene.observed), period)
    repaired = (track != scene.observed).any((1, 2))[:, None, None]
    steps = jnp.diff(track, axis=1, prepend=track[:, :1])
    steps = jnp.where(repaired, steps, scene.displacement)
    return scene.replace(observed=track, displacement=steps), offset


def limit_displacement(forecast: Array, last: Array, period: float) -> Array:
    """Forecast positions pulled smoothly within what `TOP_SPEED` reaches.

    Displacements of up to half of that are changed by less than 0.1 %.

    Args:
        forecast: [k, N, T, 2] metres.
        last: [N, 2] last observed positions, metres.
        period: of a step, seconds.

    Returns:
        [k, N, T, 2] metres.
    """
    time = period * jnp.arange(1, forecast.shape[2] + 1, dtype=forecast.dtype)
    start = last[None, :, None]
    ahead = forecast - start
    # Smooth, so that 0 has a gradient.
    distance = jnp.sqrt(jnp.square(ahead).sum(-1) + 1e-6)
    share = distance / (TOP_SPEED * time + 0.3)[None, None]
    # (1 + share^8)^(-1/8), written so that a large share does not overflow.
    low, high = jnp.minimum(share, 1), jnp.maximum(share, 1)
    factor = (high**-8 + low**8) ** (-1 / 8) / high
    return start + factor[..., None] * ahead
