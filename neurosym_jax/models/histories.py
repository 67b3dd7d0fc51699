"""Histories with missing steps: people who came late, or were hidden for a moment.

A missing position is filled in from what was seen, and `Scene.seen` says so, so that a
network which learned from incomplete histories can widen its forecast. Nothing after the
last observed step is used.
"""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import ArrayLike

from neurosym_jax.errors import InputError
from neurosym_jax.scene import Scene, refuse_masked

__all__ = ["WHOLE", "fill_history", "shorten", "whole_history"]


def whole_history(
    observed: ArrayLike, steps: int, name: str
) -> tuple[ArrayLike, np.ndarray | None]:
    """The newest `steps` of `observed [N, T, 2]`, T from 1, without NaN.

    Returns:
        Metres [N, steps, 2] and which of them were seen, [N, steps] bool, or None
        where all were. What is no array of this form, or complete, is returned as it is.

    Raises:
        InputError: for an agent who was never seen.
    """
    refuse_masked({name: observed})
    try:
        positions = np.asarray(observed, np.float64)
    except (TypeError, ValueError):
        return observed, None
    if positions.ndim != 3 or positions.shape[2] != 2 or not positions.size:
        return observed, None
    positions = positions[:, -steps:]
    missing = steps - positions.shape[1]
    if missing == 0 and not np.isnan(positions).any():
        return positions, None
    before = [(0, 0), (missing, 0), (0, 0)]
    padded = np.pad(positions, before, constant_values=np.nan)
    return fill_history(padded, name)


def fill_history(observed: ArrayLike, name: str) -> tuple[np.ndarray, np.ndarray]:
    """Positions without NaN, and which of them were seen.

    Between two seen steps an agent moves in a straight line, after the last it goes on at
    the velocity of the last two, before the first it came at the velocity of the first
    two. Somebody seen once stands.

    Args:
        observed: [N, T, 2] metres, NaN where an agent was not seen.
        name: of the argument, for messages.

    Returns:
        [N, T, 2] float64 metres and [N, T] bool.

    Raises:
        InputError: for an agent who was never seen.
    """
    positions = np.array(observed, np.float64)
    seen: Any = ~np.isnan(positions).any(axis=2)

    unseen = np.flatnonzero(~seen.any(axis=1))
    if len(unseen):
        raise InputError(f"{name}: agent {unseen[0]} has no position at any step")
    incomplete = np.flatnonzero(~seen.all(axis=1))
    for agent in incomplete:
        positions[agent] = _filled(positions[agent], seen[agent])
    return positions, seen


def _filled(track: np.ndarray, seen: np.ndarray) -> np.ndarray:
    """One track [T, 2] without NaN."""
    steps = np.flatnonzero(seen)
    number = np.arange(len(track))
    filled = np.empty_like(track)
    for axis in (0, 1):
        filled[:, axis] = np.interp(number, steps, track[steps, axis])
    if len(steps) < 2:
        return filled

    first, second = steps[:2]
    arrival = (track[second] - track[first]) / (second - first)
    early = number < first
    since = number[early, None] - first
    filled[early] = track[first] + since * arrival

    before, last = steps[-2:]
    departure = (track[last] - track[before]) / (last - before)
    late = number > last
    since = number[late, None] - last
    filled[late] = track[last] + since * departure
    return filled


WHOLE = 0.3
"""Share of people whose history stays whole."""


def shorten(scenes: Scene, key: Array) -> Scene:
    """`scenes [B, N, ...]` in which people were seen for 2 steps or more, up to all.

    A person's number of steps is drawn from all with the same probability, or is all
    with the probability `WHOLE`. Positions before are filled in as `with_steps` does;
    consumes `key`.
    """
    observed: Any = jnp.asarray(scenes.observed)
    steps = observed.shape[-2]
    cut, length = jax.random.split(key)
    people = observed.shape[:-2]
    count = jax.random.randint(length, people, 2, steps + 1)
    count = jnp.where(jax.random.uniform(cut, people) < WHOLE, steps, count)
    first = (steps - count)[..., None]
    number = jnp.arange(steps)
    seen = number >= first
    at_first = jnp.take_along_axis(observed, first[..., None], axis=-2)
    after = jnp.take_along_axis(observed, first[..., None] + 1, axis=-2)
    back = (number - first)[..., None].astype(observed.dtype)
    earlier = at_first + back * (after - at_first)
    observed = jnp.where(seen[..., None], observed, earlier)
    return scenes.replace(observed=observed, seen=seen)
