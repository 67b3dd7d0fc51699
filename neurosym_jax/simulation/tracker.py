"""What a 10 Hz people tracker does to the truth: noise, drop-outs, and ids that change.

It takes the paths of everybody, complete and exact, and gives the rows that a tracker would report
with, for each, the person whom it belongs to. It does not know where the paths come from (see
`simulation.scenarios`), and mending broken tracks is not done here.
"""

import dataclasses
import functools

import jax
import jax.numpy as jnp
import numpy as np

from neurosym_jax.errors import InputError

__all__ = ["TrackerFaults", "track"]

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


def track(
    path: np.ndarray,
    faults: TrackerFaults,
    rate: float,
    identity_key: jax.Array,
    noise_key: jax.Array,
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """The rows that a tracker reports, R of them, frame by frame.

    Args:
        path: [F, P, 2] true positions of P people, metres.
        faults: of the tracker.
        rate: frames per second.
        identity_key: of drop-outs and ids; consumed.
        noise_key: of the noise; consumed.

    Returns:
        frame [R] and person [R], which index `path`; the tracker's id [R]; position [R, 2] metres.
    """
    lost, label = _identities(identity_key, path, faults, rate)
    frame, person = np.nonzero(~lost)
    noise = np.asarray(_normal(noise_key, path.shape), np.float64)
    position = path[frame, person] + faults.noise * noise[frame, person]
    return frame, person, label[frame, person], position


def _identities(
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


@functools.partial(jax.jit, static_argnames="shape")
def _normal(key: jax.Array, shape: tuple[int, ...]) -> jax.Array:
    return jax.random.normal(key, shape, jnp.float32)


@functools.partial(jax.jit, static_argnames="shape")
def _uniform(key: jax.Array, shape: tuple[int, ...]) -> jax.Array:
    return jax.random.uniform(key, shape, jnp.float32)
