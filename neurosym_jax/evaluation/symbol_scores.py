"""Log and Brier scores of the symbols and events that k forecasts make probable.

Scored are ordered pairs within 8 m of each other at the last observation. Counts of samples become
probabilities as in `symbolic.forecast`, smoothed by one sample spread uniformly. For the class c
that came true the log score is -ln p_c (nats; Good, "Rational decisions", 1952), the Brier score
the sum over the classes of (p - [it is c])^2 (0 to 2; Brier, 1950). Both are proper. A movement
below 5 cm a step, 0.125 m/s at steps of 0.4 s, counts as standing. `studies.symbolic_forecast`
compares with a Markov chain.
"""

import jax
import jax.numpy as jnp
from jax import Array

from neurosym_jax.scene import Scene
from neurosym_jax.symbolic.events import EVENTS
from neurosym_jax.symbolic.forecast import SymbolSettings, event_steps, state_steps
from neurosym_jax.symbolic.qtc import other_pairs
from neurosym_jax.symbolic.states import all_states

__all__ = ["NEAR", "SETTINGS", "event_brier", "event_log", "state_brier", "state_log"]

SETTINGS = SymbolSettings()
STATES = len(all_states("c1"))
NEAR = 8.0
"""Distance up to which a pair is scored, metres."""


def state_log(forecast: Array, scene: Scene) -> tuple[Array, Array]:
    """[] mean log score of the QTC_C1 state at each step, nats, and [] the number of pairs."""
    hits, _ = _states(forecast, scene)
    return _mean(-jnp.log(_smoothed(hits, len(forecast), STATES)), scene)


def state_brier(forecast: Array, scene: Scene) -> tuple[Array, Array]:
    """[] mean Brier score of the QTC_C1 state at each step, and [] the number of pairs."""
    k, size, weight = len(forecast), STATES, SETTINGS.smoothing
    hits, squares = _states(forecast, scene)
    # The sum over classes of ((n_c + w / size) / (k + w))^2.
    square = (squares + 2 * weight * k / size + weight**2 / size) / (k + weight) ** 2
    return _mean(square - 2 * _smoothed(hits, k, size) + 1, scene)


def event_log(forecast: Array, scene: Scene) -> tuple[Array, Array]:
    """[] mean log score of the events, nats, and [] the number of pairs."""
    return _mean(-jnp.log(_smoothed(_events(forecast, scene), len(forecast), 2)), scene)


def event_brier(forecast: Array, scene: Scene) -> tuple[Array, Array]:
    """[] mean Brier score of the events, and [] the number of pairs."""
    hit = _smoothed(_events(forecast, scene), len(forecast), 2)
    return _mean(2 * jnp.square(1 - hit), scene)


def _smoothed(count: Array, k: int, classes: int) -> Array:
    return (count + SETTINGS.smoothing / classes) / (k + SETTINGS.smoothing)


def _mean(scores: Array, scene: Scene) -> tuple[Array, Array]:
    """[] mean over the scene's pairs of `scores [N, N, ...]`, and [] the number of pairs."""
    last = scene.observed[:, -1]
    near = jnp.square(last[:, None] - last).sum(axis=-1) <= NEAR**2
    pairs = near & other_pairs(scene.valid, len(last))
    scores = scores.reshape(*pairs.shape, -1).mean(axis=-1)
    count = pairs.sum()
    return jnp.where(pairs, scores, 0).sum() / jnp.maximum(count, 1), count


def _states(forecast: Array, scene: Scene) -> tuple[Array, Array]:
    """[N, N, T] samples in the true state, and sum over states of squared counts of samples."""

    def of_sample(future: Array) -> Array:
        return state_steps(SETTINGS, *_ends(scene, future)).astype(jnp.int16)

    true = of_sample(jnp.asarray(scene.known_future))
    # One sample after the other, for [k, N, N, T, 2] numbers of a crowd are many.
    each = jax.lax.map(of_sample, forecast)
    squares = jax.lax.map(lambda one: (each == one).sum(axis=0), each).sum(axis=0)
    return (each == true).sum(axis=0), squares


def _events(forecast: Array, scene: Scene) -> Array:
    """[N, N, E] number of samples in which an event happens or not, as in the truth."""

    def happens(future: Array) -> Array:
        first = event_steps(SETTINGS, tuple(EVENTS), *_ends(scene, future))
        return jnp.moveaxis(first < future.shape[1], 0, -1)

    true = happens(jnp.asarray(scene.known_future))
    return jax.lax.map(lambda future: happens(future) == true, forecast).sum(axis=0)


def _ends(scene: Scene, future: Array) -> tuple[Array, Array]:
    """Paths of k and of l of all pairs, which broadcast, from the last observed position on."""
    path = jnp.concatenate([jnp.asarray(scene.observed)[:, -1:], future], axis=1)
    return path[:, None], path
