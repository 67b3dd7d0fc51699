"""Ordered pairs of people whose symbols and events are forecast, and what forecasters say of them.

States are rows of a calculus's `states`.
"""

import dataclasses
import functools
from collections.abc import Sequence
from typing import NamedTuple

import jax
import numpy as np

from neurosym_jax.data.tracks import Tracks
from neurosym_jax.data.windows import Windows, cut_windows, make_batches
from neurosym_jax.evaluation.symbol_scores import NEAR
from neurosym_jax.forecasting.batched import forecast_windows
from neurosym_jax.forecasting.model import Model
from neurosym_jax.symbolic.forecast import SymbolSettings, event_steps, state_steps
from neurosym_jax.symbolic.qtc import adjacency, all_states

__all__ = ["Answer", "Cases", "counted", "make_cases", "markov_chain", "model_answer"]

PART = 2048
"""Pairs looked at in one call, so that one program serves all."""


@dataclasses.dataclass(frozen=True, eq=False)
class Cases:
    """P ordered pairs of the windows of a test set."""

    settings: SymbolSettings
    events: tuple[str, ...]
    """Names of E events."""
    windows: Windows
    rows: np.ndarray
    """[P, 2] agent windows of k and l."""
    scene: np.ndarray
    """[P] index of the window."""
    start: np.ndarray
    """[P] state at the last observation."""
    states: np.ndarray
    """[P, T] states that followed."""
    before: np.ndarray
    """[E, P] bool: events that happened during the observation."""
    after: np.ndarray
    """[E, P] bool: events that happened after it."""

    @property
    def size(self) -> int:
        """Number of states."""
        return len(all_states(self.settings.calculus))


class Answer(NamedTuple):
    """A forecast of P pairs as counts of samples, or as probabilities, which add up to `count`."""

    count: int
    states: np.ndarray
    """[T, P, S]."""
    events: np.ndarray
    """[E, P] counts of presence."""


def make_cases(
    recordings: Sequence[Tracks],
    obs_len: int,
    pred_len: int,
    settings: SymbolSettings,
    events: tuple[str, ...],
    *,
    most: int = 20_000,
) -> Cases:
    """Ordered pairs that are near each other at the last observation.

    Of more than about `most` pairs, a window starts at every n-th step only.
    """
    windows = cut_windows(recordings, obs_len, pred_len)
    rows, scene = _near(windows)
    if len(rows) > most:
        windows = cut_windows(recordings, obs_len, pred_len, skip=-(-len(rows) // most))
        rows, scene = _near(windows)
    position = windows.position[None]
    seen, before = _observed(settings, events, position[:, :, :obs_len], rows)
    then, after = _observed(settings, events, position[:, :, obs_len - 1 :], rows)
    start = seen[0, :, -1]
    return Cases(
        settings, events, windows, rows, scene, start, then[0], before[0], after[0]
    )


def counted(cases: Cases, samples: np.ndarray, events: np.ndarray) -> Answer:
    """The answer of k samples: states [k, P, T] and events [k, E, P]."""
    pairs = np.arange(len(cases.start)) * cases.size
    states = [
        np.bincount(
            (pairs + samples[:, :, step]).ravel(), minlength=cases.size * len(pairs)
        )
        for step in range(samples.shape[2])
    ]
    counts = np.stack(states).reshape(len(states), len(pairs), cases.size)
    return Answer(len(samples), counts.astype(np.float32), events.sum(axis=0))


def model_answer(cases: Cases, model: Model, *, samples: int, seed: int) -> Answer:
    """The answer of k `samples` of a model of the windows' lengths."""
    windows = cases.windows
    futures, _ = forecast_windows(model, windows, make_batches(windows), samples, seed)
    last = windows.position[None, :, windows.obs_len - 1, None]
    paths = np.concatenate(
        [np.broadcast_to(last, (*futures.shape[:2], 1, 2)), futures], axis=2
    )
    return counted(cases, *_observed(cases.settings, cases.events, paths, cases.rows))


def markov_chain(cases: Cases) -> tuple[np.ndarray, np.ndarray]:
    """Probabilities [T, S, S] of states, and [E, S] of events, after each state observed last.

    After Hanheide, Peters and Bellotto, "Analysis of human-robot spatial behaviour
    applying a qualitative trajectory calculus" (2012), and Dondrup, Bellotto and
    Hanheide (2014), every transition of the diagram, staying among them, is possible
    before anything is seen: they share a weight of 1, and all transitions whatever one
    of 0.01. An event is as frequent as it was seen after the state observed last,
    smoothed in the same way by how frequent it is altogether.
    """
    size, steps = cases.size, cases.states.shape[1]
    chain = np.concatenate([cases.start[:, None], cases.states], axis=1)
    keys = chain[:, :-1] * size + chain[:, 1:]
    counts = (
        np.bincount(keys.ravel(), minlength=size * size)
        .reshape(size, size)
        .astype(float)
    )
    allowed = adjacency(cases.settings.calculus) | np.eye(size, dtype=bool)
    counts += allowed / allowed.sum(axis=1, keepdims=True) + 0.01 / size
    once = counts / counts.sum(axis=1, keepdims=True)
    table = np.stack([np.linalg.matrix_power(once, step + 1) for step in range(steps)])
    seen = np.bincount(cases.start, minlength=size)
    happened = np.stack(
        [np.bincount(cases.start, happens, size) for happens in cases.after]
    )
    return table, (happened + cases.after.mean(axis=1, keepdims=True)) / (seen + 1)


def _near(windows: Windows) -> tuple[np.ndarray, np.ndarray]:
    """[P, 2] agent windows, and [P] scenes, of ordered pairs that are near each other."""
    rows, scenes = [], []
    last = windows.position[:, windows.obs_len - 1]
    for scene, (first, end) in enumerate(zip(windows.bounds, windows.bounds[1:])):
        places = last[first:end]
        near = np.linalg.norm(places[:, None] - places, axis=-1) <= NEAR
        np.fill_diagonal(near, val=False)
        rows.append(first + np.argwhere(near))
        scenes.append(np.full(len(rows[-1]), scene))
    return np.concatenate(rows), np.concatenate(scenes)


def _observed(
    settings: SymbolSettings,
    events: tuple[str, ...],
    position: np.ndarray,
    rows: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """[k, P, T] states and [k, E, P] events of `rows [P, 2]` of `position [k, A, T + 1, 2]`."""
    count = len(rows)
    parts = []
    for at in range(0, count, PART):
        part = np.zeros((PART, 2), int)
        part[: len(rows[at : at + PART])] = rows[at : at + PART]
        pair_paths = position[:, part.T.ravel()]
        # Relative to where k is: float32 is enough then.
        pair_paths = pair_paths - np.tile(pair_paths[:1, :PART, :1], (1, 2, 1, 1))
        parts.append(
            jax.tree.map(
                np.asarray, _look(settings, events, pair_paths.astype(np.float32))
            )
        )
    states, happened = zip(*parts)
    happened = np.concatenate(happened, axis=2)[..., :count]
    return np.concatenate(states, axis=1)[:, :count], happened.swapaxes(0, 1)


@functools.partial(jax.jit, static_argnums=(0, 1))
def _look(settings: SymbolSettings, events: tuple[str, ...], pair_paths: jax.Array):
    k, l = pair_paths[:, :PART], pair_paths[:, PART:]  # noqa: E741
    first = event_steps(settings, events, k, l)
    return state_steps(settings, k, l), first < pair_paths.shape[2] - 1
