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
from neurosym_jax.errors import InputError
from neurosym_jax.runtime.memory import refuse_beyond_memory
from neurosym_jax.symbolic.calculi import CALCULI
from neurosym_jax.symbolic.events import events_named
from neurosym_jax.symbolic.futures import SymbolSettings, event_steps, state_steps
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
    samples: ArrayLike, observed: ArrayLike, *, pairs: ArrayLike | None = None, **settings: Any
) -> SymbolicForecast:
    """Probabilities of the states and symbols of pairs at every future step.

    Args:
        samples: [k, N, T, 2] metres, futures of the scene, see `predict`.
        observed: [N, obs_len, 2] metres in the same frame; only the last positions are used.
        pairs: [P, 2] ordered pairs; None for all N^2, which takes 4 N^2 T (2 S + 5 k) bytes: with
            20 samples of 8 steps in QTC_C1 21 MB for 50 people and 2.1 GB for 500.
        **settings: see `SymbolSettings`.

    Returns:
        Arrays of [N, N, T, ...], or of [P, T, ...] for `pairs`; 0 for an agent with itself.

    Raises:
        InputError: for shapes that do not fit, an unknown calculus or setting, or more pairs than
            fit into memory.
    """
    how, paths, which = _checked(samples, observed, pairs, settings)
    count, _, steps, _ = np.shape(samples)
    _refuse(paths, which, "symbols", steps * (2 * len(CALCULI[how.calculus].states) + 5 * count))
    return _forecast(how, paths, which)


def symbolic_events(
    samples: ArrayLike,
    observed: ArrayLike,
    *,
    events: tuple[str, ...] | None = None,
    pairs: ArrayLike | None = None,
    **settings: Any,
) -> EventForecast:
    """Probabilities and times of the events of pairs.

    Args:
        samples: see `symbolic_forecast`.
        observed: see `symbolic_forecast`.
        events: E names, see `events`; None for all, in their order.
        pairs: see `symbolic_forecast`.
        **settings: see `SymbolSettings`.

    Returns:
        Arrays of [E, N, N], or of [E, P] for `pairs`; an agent has no events with itself.

    Raises:
        InputError: as `symbolic_forecast`, and for an unknown event.
    """
    how, paths, which = _checked(samples, observed, pairs, settings)
    names = tuple(events_named(events))
    count, _, steps, _ = np.shape(samples)
    _refuse(paths, which, "events", count * (8 * steps + 4 * len(names)))
    return _events(how, names, paths, which)


@functools.cache
def symbol_table(calculus: str) -> np.ndarray:
    """[S, m, V] float32: 1 where a state has the symbol -, 0, + or, with V = 4, its absence."""
    value = CALCULI[calculus]
    values = np.array([-1, 0, 1, *([ABSENT] if value.near_only else [])])
    return (value.states[..., None] == values).astype(np.float32)


def _checked(
    samples: Any, observed: Any, pairs: Any, settings: dict[str, Any]
) -> tuple[SymbolSettings, Array, np.ndarray | None]:
    """Settings; centred paths [k, N, T + 1, 2] from the last positions observed on; pairs."""
    shape, seen = np.shape(samples), np.shape(observed)
    if len(shape) != 4 or len(seen) != 3 or shape[3] != 2 or not all((*shape, *seen)):
        raise InputError(
            "samples must be [k, N, T, 2] and observed [N, obs_len, 2], not "
            f"{list(shape)} and {list(seen)}"
        )
    if shape[1] != seen[0] or seen[2] != 2:
        raise InputError(f"samples are of {shape[1]} people, observed of {seen[0]}")
    last = (observed if isinstance(observed, jax.Array) else np.asarray(observed))[:, -1]
    if isinstance(last, np.ndarray):
        # Far from the origin float32 would lose the differences.
        origin = last.astype(np.float64).mean(axis=0)
        samples, last = samples - origin, last - origin
    start = jnp.broadcast_to(jnp.asarray(last, float)[:, None], (*shape[:2], 1, 2))
    if pairs is not None:
        pairs = np.asarray(pairs, int).reshape(-1, 2)
        if not np.isin(pairs, range(seen[0])).all():
            raise InputError(f"pairs must name people by 0 to {seen[0] - 1}")
    paths = jnp.concatenate([start, jnp.asarray(samples, float)], axis=2)
    return from_json(SymbolSettings, settings, "symbols"), paths, pairs


def _refuse(paths: Array, pairs: np.ndarray | None, what: str, numbers: int) -> None:
    """Refuse so many numbers a pair where they do not fit into memory."""
    count = paths.shape[1] ** 2 if pairs is None else len(pairs)
    refuse_beyond_memory(f"{what} of {count} pairs", 4.0 * count * numbers, "name fewer pairs")


def _ends(paths: Array, pairs: Array | None) -> tuple[Array, Array, Array]:
    """Paths of k and of l, which broadcast, and [P] or [N, N] whether they are two agents."""
    if pairs is None:
        return paths[:, :, None], paths[:, None], ~jnp.eye(paths.shape[1], dtype=bool)
    k, l = pairs.T
    return paths[:, k], paths[:, l], k != l


@functools.partial(jax.jit, static_argnums=0)
def _forecast(how: SymbolSettings, paths: Array, pairs: Array | None) -> SymbolicForecast:
    k, l, others = _ends(paths, pairs)
    rows, table = state_steps(how, k, l), symbol_table(how.calculus)
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
    how: SymbolSettings, names: tuple[str, ...], paths: Array, pairs: Array | None
) -> EventForecast:
    k, l, others = _ends(paths, pairs)
    first = jnp.sort(event_steps(how, names, k, l), axis=1)
    count = (first < paths.shape[2] - 1).sum(axis=1)
    share = (count + how.smoothing / 2) / (len(paths) + how.smoothing)
    # Of n sorted times the one of rank ceil(q n): an observed time, not one between two.
    ranks = [jnp.maximum(-(-quarter * count // 4) - 1, 0) for quarter in (1, 2, 3)]
    times = [jnp.take_along_axis(first, rank[:, None], axis=1)[:, 0] for rank in ranks]
    seconds = how.period * (jnp.stack(times, axis=-1) + 1.0)
    happens = others[None] & (count > 0)
    return EventForecast(
        jnp.where(others[None], share, 0), jnp.where(happens[..., None], seconds, jnp.inf)
    )
