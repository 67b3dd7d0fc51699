"""Log scores of the symbols and events that k forecasts make probable.

Scored are ordered pairs within 8 m of each other at the last observation. Counts of samples become
probabilities as in `symbolic.forecast`, smoothed by one sample spread uniformly. The score is
-ln p_c, in nats, for the class c that came true (Good, "Rational decisions", 1952); it is proper. A
movement below 5 cm a step, 0.125 m/s at steps of 0.4 s, counts as standing.
`studies.symbolic_forecast` compares with a Markov chain.
"""

import jax
import jax.numpy as jnp
from jax import Array

from neurosym_jax.scene import Scene
from neurosym_jax.symbolic.events import EVENTS
from neurosym_jax.symbolic.forecast import SymbolSettings, event_steps, state_steps
from neurosym_jax.symbolic.qtc import other_pairs
from neurosym_jax.symbolic.states import all_states

__all__ = ["NEAR", "SETTINGS", "event_log", "state_log"]

SETTINGS = SymbolSettings()
NEAR = 8.0
"""Distance up to which a pair is scored, metres."""


def state_log(forecast: Array, scene: Scene) -> tuple[Array, Array]:
    """[] mean log score of the QTC_C1 state at each step, nats, and [] the number of pairs."""

    def states(future: Array) -> Array:
        return state_steps(SETTINGS, *_ends(scene, future)).astype(jnp.int16)

    true = states(jnp.asarray(scene.known_future))
    # One sample after the other, for [k, N, N, T, 2] numbers of a crowd are many.
    hits = jax.lax.map(lambda future: states(future) == true, forecast).sum(axis=0)
    return _mean_log(hits, len(forecast), len(all_states("c1")), scene)


def event_log(forecast: Array, scene: Scene) -> tuple[Array, Array]:
    """[] mean log score of the events, nats, and [] the number of pairs."""

    def happens(future: Array) -> Array:
        first = event_steps(SETTINGS, tuple(EVENTS), *_ends(scene, future))
        return jnp.moveaxis(first < future.shape[1], 0, -1)

    true = happens(jnp.asarray(scene.known_future))
    hits = jax.lax.map(lambda future: happens(future) == true, forecast).sum(axis=0)
    return _mean_log(hits, len(forecast), 2, scene)


def _mean_log(hits: Array, k: int, classes: int, scene: Scene) -> tuple[Array, Array]:
    """[] mean score of the scene's pairs, of whom `hits [N, N, ...]` of k samples are right."""
    smoothing = SETTINGS.smoothing
    scores = -jnp.log((hits + smoothing / classes) / (k + smoothing))
    last = scene.observed[:, -1]
    near = jnp.square(last[:, None] - last).sum(axis=-1) <= NEAR**2
    pairs = near & other_pairs(scene.valid)
    count = pairs.sum()
    each = jnp.where(pairs, scores.reshape(*pairs.shape, -1).mean(axis=-1), 0)
    return each.sum() / jnp.maximum(count, 1), count


def _ends(scene: Scene, future: Array) -> tuple[Array, Array]:
    """Paths of k and of l of all pairs, which broadcast, from the last observed position on."""
    path = jnp.concatenate([jnp.asarray(scene.observed)[:, -1:], future], axis=1)
    return path[:, None], path
