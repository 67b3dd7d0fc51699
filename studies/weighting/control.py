"""The positive control: simulated people who give way by the QTC_C1 state of the pair.

Each person walks straight at their own speed. At the last observed step they look up,
and from then on give way, to the right and slower, to the nearest of those on their
path, the more the nearer. On one's path is whose pair with one is in one of two states:
both approach, and both drift to the same side of the floor, so that the bearing stays
what it is. Who passes, follows or leaves does not matter, however near. So a weighting
that is 1 for these states and 0 for all others is right. A study that does not see its
effect here may not say "no" of real people.
"""

import numpy as np

from neurosym_jax.data.tracks import PERIOD
from neurosym_jax.data.windows import Windows
from neurosym_jax.scene import scene_identity
from neurosym_jax.symbolic.qtc import encode_state, observe

__all__ = ["LENGTHS", "ON_ONES_PATH", "control"]

LENGTHS = (8, 12)
"""Steps observed and forecast, of every set."""

PEOPLE, WIDTH = 12, 8.0
"""In a scene, and metres of the square that they are in when they look up."""
PACE = (0.9, 1.5)
"""Metres a second."""
PUSH, RANGE, RELAXATION = 1.5, 3.0, 1.0
"""Metres a second squared at no distance, metres, seconds."""
WOBBLE = 0.02
"""Metres a second that a velocity errs by from step to step, standard deviation."""


def _path_table() -> np.ndarray:
    """[81] by state code: 1 for a neighbour on one's path, else 0."""
    table = np.zeros(81)
    for side in (-1, 1):
        # - - + -
        table[np.ravel_multi_index((0, 0, 1 + side, 1 - side), (3, 3, 3, 3))] = 1
    return table


ON_ONES_PATH = _path_table()


def control(scenes: int, seed: int, strength: float = 1.0) -> Windows:
    """Windows of `scenes` scenes, each a simulation of its own; `strength` scales reactions."""
    draw = np.random.default_rng(seed)
    observed, forecast = LENGTHS
    angle = draw.uniform(0, 2 * np.pi, (scenes, PEOPLE))
    pace = draw.uniform(*PACE, (scenes, PEOPLE))
    preferred = pace[..., None] * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    velocity = preferred.copy()
    last = draw.uniform(-WIDTH / 2, WIDTH / 2, preferred.shape)
    path = [last - preferred * PERIOD * (observed - 1)]
    force = np.zeros_like(last)
    for step in range(1, observed + forecast):
        velocity = velocity + PERIOD * ((preferred - velocity) / RELAXATION + force)
        velocity = velocity + draw.normal(0, WOBBLE, velocity.shape)
        path.append(path[-1] + PERIOD * velocity)
        if step == observed - 1:
            force = strength * _giving_way(path[-2], path[-1], velocity)
    return Windows(
        position=np.stack(path, axis=2).reshape(-1, observed + forecast, 2),
        agent=np.tile(np.arange(PEOPLE), scenes),
        bounds=np.arange(scenes + 1) * PEOPLE,
        identity=scene_identity(f"control/{seed}", np.arange(scenes)),
        obs_len=observed,
    )


def _giving_way(
    before: np.ndarray, now: np.ndarray, velocity: np.ndarray
) -> np.ndarray:
    """Accelerations [S, N, 2], of positions [S, N, 2] a step apart and the velocities."""
    steps = np.stack([before, now], axis=2)
    states = observe(steps[:, :, None], steps[:, None])[..., 0, :]
    # A person is not on their own path: the state with oneself is none of these.
    on_path = ON_ONES_PATH[np.asarray(encode_state(states))] > 0
    distance = np.linalg.norm(now[:, :, None] - now[:, None], axis=-1)
    nearest = np.where(on_path, distance, np.inf).min(axis=-1, keepdims=True)
    ahead = velocity / np.linalg.norm(velocity, axis=-1, keepdims=True)
    right = np.stack([ahead[..., 1], -ahead[..., 0]], axis=-1)
    return PUSH * np.exp(-nearest / RANGE) * (right - 0.5 * ahead)
