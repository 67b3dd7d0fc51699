"""Faults of a 10 Hz people tracker: noise, drop-outs, and ids that change.

From exact paths it makes the rows that a tracker would report, with the true person of each row.
"""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np

from neurosym_jax.configuration import Checked, NotNegative, Share

__all__ = ["TrackerFaults", "track"]

SWAP_DISTANCE = 0.8  # m within which a tracker can confuse two people


@dataclasses.dataclass(frozen=True)
class TrackerFaults(Checked):
    """Faults of a tracker; the default is a good tracker with a little noise."""

    noise: NotNegative = 0.02  # standard deviation in metres of each coordinate
    dropout: Share = 0.0  # probability per frame that the tracker loses a person
    dropout_seconds: NotNegative = 1.0  # mean length of a loss, geometrically distributed
    id_switch: Share = 0.0  # probability that a lost person comes back under a new id
    id_swap: Share = 0.0  # probability per frame that two people within 0.8 m exchange their ids


def track(
    path: np.ndarray,
    faults: TrackerFaults,
    rate: float,
    identity_key: jax.Array,
    noise_key: jax.Array,
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """The R rows that a tracker reports, frame by frame: [R] frame and [R] person, which index
    `path` [F, P, 2] (metres), [R] the tracker's id, and [R, 2] the position.

    Frames come at `rate` a second; the keys are consumed.
    """
    lost, label = _identities(identity_key, path, faults, rate)
    frame, person = np.nonzero(~lost)
    noise = np.asarray(jax.random.normal(noise_key, path.shape, jnp.float32), np.float64)
    position = path[frame, person] + faults.noise * noise[frame, person]
    return frame, person, label[frame, person], position


def _identities(
    key: jax.Array, path: np.ndarray, faults: TrackerFaults, rate: float
) -> tuple[np.ndarray, np.ndarray]:
    """[F, P] bool: who is lost; and [F, P] int64: the tracker's ids."""
    frames, people, _ = path.shape
    if faults.dropout == faults.id_swap == 0:
        return np.zeros((frames, people), bool), np.tile(np.arange(people), (frames, 1))
    chance = jax.random.uniform(key, (frames, people, 3 + people), jnp.float32)
    chance = np.asarray(chance, np.float64)
    frame = np.arange(frames)[:, None]
    # Geometric length by inversion: P(more than n frames) = (1 - 1 / mean) ** n.
    mean = max(faults.dropout_seconds * rate, 1.0)
    tail = np.log1p(-1 / mean) if mean > 1 else -np.inf
    length = 1 + np.floor(np.log1p(-chance[..., 1]) / tail)
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
