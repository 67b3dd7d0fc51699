"""Samples of a scene that know its place: some of a network's, exchanged for draws.

A network's k samples are to cover what may happen: the best of them counts. What people
did here says more of what may happen here. So while it lowers the expected error of the
best sample, a sample is exchanged for a draw of the distribution with the memory: of
the best for the whole scene, and the best for each person. What is expected: half of
the memory's share of the probability is with these draws, the rest with the network's
samples themselves. So who has no memory keeps all samples.
"""

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from neurosym_jax.models.place.mixture import Remembered
from neurosym_jax.runtime.programs import program
from neurosym_jax.scene import model_dtype

__all__ = ["DRAWS", "exchange", "exchange_batch", "exchange_scene"]

DRAWS = 100
"""Draws of a scene among which samples are found."""
EXCHANGED = 10
"""Most samples of a scene that are exchanged."""
TRUST = 0.5
"""Weight of the draws for a memory that has the whole probability, see `studies/pages/place.md`."""


def exchange(
    samples: Array, probability: Array, draws: Array, valid: Array, share: Array
) -> Array:
    """`samples [k, N, T, 2]` of a scene, some of them exchanged for draws.

    The most probable sample stays: it is the one to act on.

    Args:
        samples: of a network, metres.
        probability: [k] of the samples.
        draws: [n, N, T, 2] equally probable futures of the same scene.
        valid: [N] bool, False for padding.
        share: [N] probability that the memory has of each person's draws.
    """
    count = len(samples)
    candidates = jnp.concatenate([samples, draws])
    people = valid / jnp.maximum(valid.sum(), 1)
    apart = _distances(candidates)  # [c, c, N]
    together = apart @ people
    trust = TRUST * (share @ people)
    evenly = jnp.full(len(draws), trust / len(draws))
    weight = jnp.concatenate([(1 - trust) * probability, evenly])
    without_each = jnp.where(jnp.eye(count, dtype=bool), jnp.inf, 0)
    central = probability.argmax()

    def exchange_one(_: Array, chosen: Array) -> Array:
        # The sample that the others replace best, ...
        error = together[chosen]
        others = (error + without_each[..., None]).min(axis=1)  # [k, c]
        lost = (others @ weight).at[central].set(jnp.inf)
        sample = lost.argmin()
        # ... and the candidate that does so with them; it may be the sample itself.
        of_each = apart[chosen] + without_each[sample][:, None, None]
        of_each = jnp.minimum(of_each.min(axis=0), apart) @ people
        joint = jnp.minimum(others[sample], together)
        expected = (joint + of_each) @ weight
        return chosen.at[sample].set(expected.argmin())

    chosen = jnp.arange(count)
    if count > 1:
        chosen = jax.lax.fori_loop(0, EXCHANGED, exchange_one, chosen)
    return candidates[chosen]


def exchange_batch(
    samples: np.ndarray,
    probability: np.ndarray | None,
    draws: np.ndarray,
    valid: np.ndarray,
    memory: Remembered,
) -> np.ndarray:
    """`exchange` for B scenes: `samples [k, B, N, T, 2]`, `draws [n, B, N, T, 2]`, `valid [B, N]`.

    Args:
        samples, draws, valid: those of `exchange`.
        probability: [k, B]; None where all are the same.
        memory: with a leading axis B.
    """
    if probability is None:
        count = len(samples)
        probability = np.full((count, len(valid)), 1 / count, samples.dtype)
    share = np.asarray(memory.share).sum(axis=1)
    return np.asarray(_exchange_batch(samples, probability, draws, valid, share))


def exchange_scene(
    samples: np.ndarray,
    probability: np.ndarray,
    draws: np.ndarray,
    memory: Remembered,
) -> np.ndarray:
    """`exchange` for one scene in any frame: `samples [k, N, T, 2]` and `draws [n, N, T, 2]`.

    The `memory` has the slots of a padded forecast.
    """
    origin = samples.mean(axis=(0, 1, 2))
    people, slots = samples.shape[1], memory.share.shape[1]
    padding = (0, 0), (0, slots - people), (0, 0), (0, 0)

    def as_batch(futures: np.ndarray) -> np.ndarray:
        near = (futures - origin).astype(model_dtype())
        return np.pad(near, padding)[:, None]

    exchanged = exchange_batch(
        as_batch(samples),
        probability[:, None].astype(model_dtype()),
        as_batch(draws),
        np.arange(slots)[None] < people,
        Remembered(*(np.asarray(part)[None] for part in memory)),
    )
    return exchanged[:, 0, :people] + origin


@program()
def _exchange_batch(samples, probability, draws, valid, share):
    parts = samples.swapaxes(0, 1), probability.T, draws.swapaxes(0, 1), valid, share
    return jax.lax.map(lambda part: exchange(*part), parts).swapaxes(0, 1)


def _distances(candidates: Array) -> Array:
    """[c, c, N] distances of `candidates [c, N, T, 2]`, means over steps."""

    def from_one(candidate: Array) -> Array:
        return jnp.linalg.norm(candidates - candidate, axis=-1).mean(axis=2)

    # One at a time: all at once would leave the cache.
    return jax.lax.map(from_one, candidates)
