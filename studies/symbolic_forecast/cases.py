"""Pairs whose symbols and events are forecast: what happened to them, and what forecasters say.

An answer holds samples or probabilities; how good they are is `symbols`'. States are rows of
a calculus's `states`.
"""

import dataclasses
import functools
from collections.abc import Sequence

import jax
import numpy as np

from neurosym_jax.data.batching import make_batches
from neurosym_jax.data.tracks import Tracks
from neurosym_jax.data.windows import Windows, cut_windows
from neurosym_jax.forecasting.batched import draw_noises, forecast_batches
from neurosym_jax.forecasting.model import Model
from neurosym_jax.symbolic.calculi import CALCULI
from neurosym_jax.symbolic.cnd import adjacency
from neurosym_jax.symbolic.futures import Futures, SymbolSettings, event_steps, pair_states_of

__all__ = ["Answer", "Cases", "make_cases", "markov_chain", "model_answer", "persistence"]

PART = 2048
"""Pairs looked at in one call, so that one program serves all."""
NEAR = 8.0
"""Metres up to which two people are near each other."""


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
    """[P] number of the window."""
    start: np.ndarray
    """[P] the state observed last."""
    states: np.ndarray
    """[P, T] the states that followed."""
    before: np.ndarray
    """[E, P] bool: which events happened while the pair was observed."""
    after: np.ndarray
    """[E, P] bool: which happened then."""


@dataclasses.dataclass(frozen=True, eq=False)
class Answer:
    """What a forecaster says of P pairs: by samples that are counted, or by probabilities."""

    samples: np.ndarray | None = None
    """[k, P, T] states."""
    sampled_events: np.ndarray | None = None
    """[k, E, P] bool."""
    table: np.ndarray | None = None
    """[T, S, S] probabilities of the states at each step, given the state observed last."""
    event_table: np.ndarray | None = None
    """[E, S] probabilities of the events, given the state observed last."""

    @property
    def count(self) -> int:
        """How much all counts add up to: the samples, or 1 for probabilities."""
        return 1 if self.samples is None else len(self.samples)

    def of_states(self, cases: Cases, step: int) -> np.ndarray:
        """[P, S] counts of the states at a step."""
        if self.samples is None:
            assert self.table is not None
            return self.table[step][cases.start]
        size, pairs = len(CALCULI[cases.settings.calculus].states), np.arange(len(cases.start))
        keys = (pairs * size + self.samples[:, :, step]).ravel()
        return np.bincount(keys, minlength=size * len(pairs)).reshape(-1, size)

    def of_event(self, cases: Cases, number: int) -> np.ndarray | None:
        """[P, 2] counts of the event's absence and presence; None where nothing is said."""
        if self.sampled_events is not None:
            happens = self.sampled_events[:, number].sum(axis=0)
        elif self.event_table is not None:
            happens = self.event_table[number][cases.start]
        else:
            return None
        return np.stack([self.count - happens, happens], axis=1)


def make_cases(
    recordings: Sequence[Tracks],
    obs_len: int,
    pred_len: int,
    settings: SymbolSettings,
    events: tuple[str, ...],
    *,
    most: int = 20_000,
) -> Cases:
    """Ordered pairs that are near each other when they are observed last.

    Args:
        recordings: track tables on one grid.
        obs_len: observed steps, 2 or more.
        pred_len: steps that follow.
        settings: of the symbols.
        events: names.
        most: pairs, about; if there are more, a window starts at every n-th step only.

    Raises:
        InputError: for recordings without a single window.
    """
    windows = cut_windows(recordings, obs_len, pred_len)
    rows, scene = _near(windows)
    if len(rows) > most:
        windows = cut_windows(recordings, obs_len, pred_len, skip=-(-len(rows) // most))
        rows, scene = _near(windows)
    position = windows.position[None]
    seen, before = _observed(settings, events, position[:, :, :obs_len], rows)
    then, after = _observed(settings, events, position[:, :, obs_len - 1 :], rows)
    return Cases(
        settings, events, windows, rows, scene, seen[0, :, -1], then[0], before[0], after[0]
    )


def model_answer(cases: Cases, model: Model, *, samples: int, seed: int) -> Answer:
    """What a model's sampled futures of the cases' windows say.

    Args:
        cases: of windows as long as the model's.
        model: a network or a baseline.
        samples: k, of which a deterministic forecaster makes one.
        seed: determines, with the scene and the sample, the noise.
    """
    batches = make_batches(cases.windows)
    scenes = [batch.scene for batch in batches]
    forecaster = model.forecaster
    noises = draw_noises(forecaster.noise, scenes, samples if forecaster.noise.dim else 1, seed)
    futures = forecast_batches(forecaster, model.params, scenes, noises)
    last = np.concatenate([scene.observed[scene.valid][:, -1:] for scene in scenes])
    start = np.broadcast_to(last, (len(futures), *last.shape))
    whole = np.empty((*futures.shape[:2], futures.shape[2] + 1, 2))
    there = np.concatenate([batch.index[batch.index >= 0] for batch in batches])
    whole[:, cases.windows.rows(there)] = np.concatenate([start, futures], axis=2)
    of_states, of_events = _observed(cases.settings, cases.events, whole, cases.rows)
    return Answer(of_states, of_events)


def persistence(cases: Cases) -> Answer:
    """The state observed last stays; what happened while a pair was observed happens again."""
    stays = np.repeat(cases.start[:, None], cases.states.shape[1], axis=1)
    return Answer(stays[None], cases.before[None])


def markov_chain(cases: Cases, *, within: bool = False) -> Answer:
    """A chain over states, learned from cases and smoothed by the neighbourhood diagram.

    After Hanheide, Peters and Bellotto, "Analysis of human-robot spatial behaviour applying a
    qualitative trajectory calculus" (2012), and Dondrup, Bellotto and Hanheide (2014), every
    transition of the diagram, staying among them, is possible before anything is seen: they share a
    weight of 1, and all transitions whatever one of 0.01. An event is as frequent as it was seen
    after the state observed last, smoothed in the same way by how frequent it is altogether.

    Args:
        cases: of training scenes.
        within: count no transition that is not of the diagram, which sampled states often skip.
    """
    size, steps = len(CALCULI[cases.settings.calculus].states), cases.states.shape[1]
    chain = np.concatenate([cases.start[:, None], cases.states], axis=1)
    keys = chain[:, :-1] * size + chain[:, 1:]
    counts = np.bincount(keys.ravel(), minlength=size * size).reshape(size, size).astype(float)
    allowed = adjacency(cases.settings.calculus) | np.eye(size, dtype=bool)
    counts *= allowed if within else 1
    counts += allowed / allowed.sum(axis=1, keepdims=True) + 0.01 / size
    once = counts / counts.sum(axis=1, keepdims=True)
    powers = [once]
    for _ in range(steps - 1):
        powers.append(powers[-1] @ once)
    if within:
        return Answer(table=np.stack(powers))
    seen = np.bincount(cases.start, minlength=size)
    happened = np.stack([np.bincount(cases.start, one, size) for one in cases.after])
    share = cases.after.mean(axis=1, keepdims=True)
    return Answer(table=np.stack(powers), event_table=(happened + share) / (seen + 1))


def _near(windows: Windows) -> tuple[np.ndarray, np.ndarray]:
    """[P, 2] agent windows, and [P] scenes, of ordered pairs that are near each other."""
    rows, scenes = [], []
    last = windows.position[:, windows.obs_len - 1]
    for scene, (first, end) in enumerate(zip(windows.bounds, windows.bounds[1:])):
        there = last[first:end]
        near = np.linalg.norm(there[:, None] - there, axis=-1) <= NEAR
        np.fill_diagonal(near, val=False)
        rows.append(first + np.argwhere(near))
        scenes.append(np.full(len(rows[-1]), scene))
    return np.concatenate(rows), np.concatenate(scenes)


def _observed(
    settings: SymbolSettings, events: tuple[str, ...], position: np.ndarray, rows: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """[k, P, T] states and [k, E, P] events of `rows [P, 2]` of `position [k, A, T + 1, 2]`."""
    count = len(rows)
    parts = []
    for at in range(0, count, PART):
        part = np.zeros((PART, 2), int)
        part[: len(rows[at : at + PART])] = rows[at : at + PART]
        both = position[:, part.T.ravel()]
        # Relative to where k is: float32 is enough then.
        both = both - np.tile(both[:1, :PART, :1], (1, 2, 1, 1))
        parts.append(jax.tree.map(np.asarray, _look(settings, events, both.astype(np.float32))))
    found, happened = zip(*parts)
    happened = np.concatenate(happened, axis=2)[..., :count]
    return np.concatenate(found, axis=1)[:, :count], happened.swapaxes(0, 1)


@functools.partial(jax.jit, static_argnums=(0, 1))
def _look(settings: SymbolSettings, events: tuple[str, ...], both: jax.Array):
    pairs = jax.numpy.arange(PART)
    futures = Futures(both[:, :, 1:], both[0, :, 0], jax.numpy.stack([pairs, pairs + PART], axis=1))
    first = event_steps(settings, events, futures)
    return pair_states_of(settings, futures), first < both.shape[2] - 1
