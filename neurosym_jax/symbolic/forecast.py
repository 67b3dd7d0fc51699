"""Probabilities of the states and events of a scene's pairs, from k sampled futures.

Every sample is a joint future of the scene, so in each of them a pair is in one state at each step,
and an event happens or not. The share of samples is smoothed, because an event that happens in none
of k samples is not impossible: of C classes the one counted n times gets

    p = (n + w / C) / (k + w)

the mean of a Dirichlet distribution with a uniform prior of weight w: as if w more samples had been
seen. The default w = 1 is Perks' prior (1947, "Some observations on inverse probability including a
new indifference rule"), and for an event, which has two classes, Jeffreys'.
`evaluation.symbol_scores` scores the probabilities.
"""

import functools
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import ArrayLike

from neurosym_jax.configuration import from_json
from neurosym_jax.runtime.memory import refuse_beyond_memory
from neurosym_jax.symbolic.calculi import CALCULI
from neurosym_jax.symbolic.events import events_named
from neurosym_jax.symbolic.futures import Futures, SymbolSettings, event_steps, pair_states_of
from neurosym_jax.symbolic.states import ABSENT

__all__ = [
    "EventForecast",
    "SymbolicForecast",
    "symbol_table",
    "symbolic_events",
    "symbolic_forecast",
]


class SymbolicForecast(NamedTuple):
    """Probabilities of P pairs, or of [N, N] ordered ones, over T steps."""

    states: Array
    """[..., T, S] in the order of the calculus's `states`."""
    symbols: Array
    """[..., T, m, V] of each symbol: -, 0, + and, where symbols can be absent, absence."""


class EventForecast(NamedTuple):
    """Probabilities and times of E events of P pairs, or of [N, N] ordered ones."""

    probability: Array
    """[E, ...] that it happens within the T steps."""
    seconds: Array
    """[E, ..., 3] quartiles of the time of the first happening, from the last observation, over the
    samples in which it happens; infinite where it never does. The middle one is the median."""


def symbolic_forecast(
    samples: ArrayLike,
    observed: ArrayLike,
    *,
    pairs: ArrayLike | None = None,
    valid: ArrayLike | None = None,
    **settings: Any,
) -> SymbolicForecast:
    """Probabilities of the states and symbols of pairs at every future step.

    Args:
        samples: [k, N, T, 2] metres, futures of the scene, see `predict`.
        observed: [N, obs_len, 2] metres in the same frame; only the last positions are used.
        pairs: [P, 2] ordered pairs; None for all N^2, which takes 4 N^2 T (2 S + 5 k) bytes: with
            20 samples of 8 steps in QTC_C1 21 MB for 50 people and 2.1 GB for 500.
        valid: [N] bool, False for padding; pairs with padding, or of an agent with itself, get 0.
        **settings: see `SymbolSettings`.

    Returns:
        Arrays of [N, N, T, ...], or of [P, T, ...] for `pairs`.

    Raises:
        InputError: for shapes that do not fit, an unknown calculus or setting, or more pairs than
            fit into memory.
    """
    how, futures = _settings(settings), Futures.of(samples, observed, pairs)
    others = futures.others(valid)
    size = len(CALCULI[how.calculus].states)
    refuse_beyond_memory(
        f"symbols of {others.size} pairs",
        4.0 * others.size * futures.samples.shape[2] * (2 * size + 5 * len(futures.samples)),
        "name fewer pairs",
    )
    return _forecast(how, futures, others)


def symbolic_events(
    samples: ArrayLike,
    observed: ArrayLike,
    *,
    events: tuple[str, ...] | None = None,
    pairs: ArrayLike | None = None,
    valid: ArrayLike | None = None,
    **settings: Any,
) -> EventForecast:
    """Probabilities and times of the events of pairs.

    Args:
        samples: see `symbolic_forecast`.
        observed: see `symbolic_forecast`.
        events: E names, see `events`; None for all, in their order.
        pairs: see `symbolic_forecast`.
        valid: see `symbolic_forecast`.
        **settings: see `SymbolSettings`.

    Returns:
        Arrays of [E, N, N], or of [E, P] for `pairs`.

    Raises:
        InputError: as `symbolic_forecast`, and for an unknown event.
    """
    how, futures = _settings(settings), Futures.of(samples, observed, pairs)
    others = futures.others(valid)
    names = tuple(events_named(events))
    refuse_beyond_memory(
        f"events of {others.size} pairs",
        4.0 * others.size * len(futures.samples) * (8 * futures.samples.shape[2] + 4 * len(names)),
        "name fewer pairs",
    )
    return _events(how, names, futures, others)


@functools.cache
def symbol_table(calculus: str) -> np.ndarray:
    """[S, m, V] float32: 1 where a state has the symbol -, 0, + or, with V = 4, its absence."""
    value = CALCULI[calculus]
    values = np.array([-1, 0, 1, *([ABSENT] if value.optional else [])])
    return (value.states[..., None] == values).astype(np.float32)


def _settings(given: dict[str, Any]) -> SymbolSettings:
    return from_json(SymbolSettings, given, "symbols")


@functools.partial(jax.jit, static_argnums=0)
def _forecast(how: SymbolSettings, futures: Futures, others: Array) -> SymbolicForecast:
    rows, table = pair_states_of(how, futures), symbol_table(how.calculus)
    count, size = rows[0].size, len(table)
    first = size * jnp.arange(count).reshape(1, *rows.shape[1:])
    # A state that its calculus does not list falls beyond the end, and is not counted.
    place = jnp.where(rows < 0, count * size, first + rows)
    counts = jnp.zeros(count * size).at[place.ravel()].add(1, mode="drop")
    seen = counts.reshape(count, size) + how.smoothing * (1 / size)
    shares = (seen / (len(rows) + how.smoothing)).reshape(*rows.shape[1:], size)
    states = jnp.where(others[..., None, None], shares, 0)
    return SymbolicForecast(states, jnp.tensordot(states, table, 1))


@functools.partial(jax.jit, static_argnums=(0, 1))
def _events(
    how: SymbolSettings, names: tuple[str, ...], futures: Futures, others: Array
) -> EventForecast:
    samples, _, steps, _ = futures.samples.shape
    first = jnp.sort(event_steps(how, names, futures), axis=1)
    count = (first < steps).sum(axis=1)
    share = (count + how.smoothing / 2) / (samples + how.smoothing)
    # Of n sorted times the one of rank ceil(q n): an observed time, not one between two.
    ranks = [jnp.maximum(-(-quarter * count // 4) - 1, 0) for quarter in (1, 2, 3)]
    times = [jnp.take_along_axis(first, rank[:, None], axis=1)[:, 0] for rank in ranks]
    seconds = how.period * (jnp.stack(times, axis=-1) + 1.0)
    seconds = jnp.where((count > 0)[..., None], seconds, jnp.inf)
    return EventForecast(
        jnp.where(others[None], share, 0), jnp.where(others[None, ..., None], seconds, jnp.inf)
    )
