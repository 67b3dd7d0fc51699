"""Log scores of the symbols and events that k forecasts make probable.

Scored are ordered pairs within 8 m of each other at the last observation. Counts of
samples become probabilities as in `symbolic.forecast`, smoothed by one sample spread
uniformly. The score is -ln p_c, in nats, for the class c that came true (Good,
"Rational decisions", 1952); it is proper. A movement below 0.125 m/s counts as
standing, and events are timed in seconds, at any period. docs/symbolic_forecast.md
compares with a Markov chain.
"""

import dataclasses
from collections.abc import Callable

import jax
import jax.numpy as jnp
from jax import Array

from neurosym_jax.scene import Scene
from neurosym_jax.symbolic.events import EVENTS
from neurosym_jax.symbolic.forecast import SymbolSettings, event_steps, state_steps
from neurosym_jax.symbolic.qtc import all_states, other_pairs

__all__ = ["NEAR", "SETTINGS", "event_log", "state_log"]

SETTINGS = SymbolSettings()
NEAR = 8.0
"""Distance up to which a pair is scored, metres."""


def state_log(forecast: Array, scene: Scene) -> tuple[Array, Array]:
    """[] mean log score of the QTC_C1 state at each step, nats, and [] the number of pairs."""

    def states(settings: SymbolSettings, *paths: Array) -> Array:
        return state_steps(settings, *paths).astype(jnp.int16)

    return _log_score(states, len(all_states("c1")), forecast, scene)


def event_log(forecast: Array, scene: Scene) -> tuple[Array, Array]:
    """[] mean log score of the events, nats, and [] the number of pairs."""

    def happens(settings: SymbolSettings, *paths: Array) -> Array:
        first = event_steps(settings, tuple(EVENTS), *paths)
        return jnp.moveaxis(first < forecast.shape[2], 0, -1)

    return _log_score(happens, 2, forecast, scene)


def _log_score(
    classes_of: Callable[..., Array], classes: int, forecast: Array, scene: Scene
) -> tuple[Array, Array]:
    """The mean score of the scene's pairs, whose paths have the classes `[N, N, ...]`."""
    settings = dataclasses.replace(SETTINGS, period=scene.period)
    last = jnp.asarray(scene.observed)[:, -1]

    def of(future: Array) -> Array:
        path = jnp.concatenate([last[:, None], future], axis=1)
        return classes_of(settings, path[:, None], path)

    true = of(jnp.asarray(scene.known_future))
    # One sample after the other, for [k, N, N, T, 2] numbers of a crowd are many.
    hits = jax.lax.map(lambda future: of(future) == true, forecast).sum(axis=0)
    smoothing = settings.smoothing
    scores = -jnp.log((hits + smoothing / classes) / (len(forecast) + smoothing))
    near = jnp.square(last[:, None] - last[None]).sum(axis=-1) <= NEAR**2
    pairs = near & other_pairs(scene.valid)
    count = pairs.sum()
    pair_scores = jnp.where(pairs, scores.reshape(*pairs.shape, -1).mean(axis=-1), 0)
    return pair_scores.sum() / jnp.maximum(count, 1), count
