"""Probabilities of the states and events of a scene's pairs, from k sampled futures, and as text.

Every sample is a joint future of the scene, so in each of them a pair is in one state
at each step, and an event happens or not. The share of samples is smoothed, because an
event that happens in none of k samples is not impossible: of C classes the one counted
n times gets

    p = (n + w / C) / (k + w)

the mean of a Dirichlet distribution with a uniform prior of weight w: as if w more
samples had been seen. The default w = 1 is Perks' prior (1947, "Some observations on
inverse probability including a new indifference rule"), and for an event, which has two
classes, Jeffreys'. Samples in which a person is not there (NaN) are not among the k;
where there is none the probabilities are 0.
"""

import dataclasses
import itertools
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import ArrayLike

from neurosym_jax.configuration import Checked, NotNegative, Positive, from_json
from neurosym_jax.errors import InputError, printable, refuse_masked
from neurosym_jax.runtime.programs import program
from neurosym_jax.symbolic.events import EVENTS, PairFuture
from neurosym_jax.symbolic.qtc import (
    ABSENT,
    DISTANCES,
    Calculus,
    Distances,
    absent_steps,
    all_states,
    observe,
    state_index,
    state_texts,
)

__all__ = [
    "EventForecast",
    "SymbolSettings",
    "event_steps",
    "forecast_rows",
    "format_forecast",
]
__all__ += ["format_pairs", "state_steps", "symbolic_events", "symbolic_forecast"]


@dataclasses.dataclass(frozen=True)
class SymbolSettings(Checked):
    """Period, thresholds and the smoothing of probabilities."""

    period: Positive = 0.4
    """Seconds between steps."""
    calculus: Calculus = "c1"
    """Calculus of the states, see `qtc`; events are of QTC_C1."""
    speed: NotNegative = 0.125
    """Metres per second up to which a movement towards, away or to a side counts as none, so that
    it means the same at every period."""
    smoothing: NotNegative = 1.0
    """Weight of the prior in samples; 0 leaves shares as they are counted."""
    distances: Distances = DISTANCES
    """Distances of `argd`, metres, increasing."""

    @property
    def states(self) -> np.ndarray:
        """[S, m] the states of the calculus, see `all_states`."""
        return all_states(self.calculus, self.distances)

    def observe(self, k: Array, l: Array, calculus: Calculus) -> Array:
        """`qtc.observe` of paths [..., T + 1, 2] with the threshold in metres per step."""
        step = self.speed * self.period
        factors: Any = {"quantisation_factor": step, "side_quantisation_factor": step}
        return observe(k, l, calculus, distances=self.distances, **factors)


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
    **settings: Any,
) -> Array:
    """Probabilities [N, N, T, S] of the states of pairs at every future step, or [P, T, S].

    They are in the order of `all_states(calculus)`, and 0 for an agent with itself and
    where a person is not there.

    Args:
        samples: [k, N, T, 2] metres, futures of the scene, see `predict`.
        observed: [N, obs_len, 2] metres in the same frame; only the last positions are
            used.
        pairs: [P, 2] ordered pairs; None for all N^2, which takes 4 N^2 T (2 S + 5 k)
            bytes: with 20 samples of 8 steps in QTC_C1 21 MB for 50 people and 2.1 GB
            for 500.
        **settings: see `SymbolSettings`.

    Raises:
        InputError: for shapes that do not fit, an unknown calculus or setting.
    """
    return _forecast(*_checked(samples, observed, pairs, settings))


def symbolic_events(
    samples: ArrayLike,
    observed: ArrayLike,
    *,
    events: tuple[str, ...] | None = None,
    pairs: ArrayLike | None = None,
    **settings: Any,
) -> EventForecast:
    """Probabilities and times of E events of pairs, [E, N, N] or, for `pairs`, [E, P].

    `events` are names, None for all of `EVENTS`; see `symbolic_forecast` for the other
    arguments.
    """
    checked, *paths = _checked(samples, observed, pairs, settings)
    return _events(checked, tuple(EVENTS) if events is None else tuple(events), *paths)


def state_steps(settings: SymbolSettings, k: Array, l: Array) -> Array:
    """[..., T] rows of the pairs' states in `all_states`, S where a person is not there.

    Paths `k` and `l` [..., T + 1, 2] begin with the last position observed, and
    broadcast.
    """
    states = settings.observe(k, l, settings.calculus)
    return state_index(settings.calculus, states, settings.distances)


def event_steps(
    settings: SymbolSettings, names: tuple[str, ...], k: Array, l: Array
) -> Array:
    """The step at which each of E events first happens to pairs [..., T + 1, 2], see `state_steps`.

    Returns [E, ...] int32 steps from 0; T where it does not happen.

    Raises:
        InputError: for an event that returns another shape or type than `Event` says.
    """
    states = settings.observe(k, l, "c1")
    k, l = jnp.broadcast_arrays(k, l)
    future = PairFuture(states, k, l, settings.period, settings.speed)
    steps = states.shape[-2]
    first = []
    for name in names:
        happens = EVENTS[name].happens(future)
        if happens.shape != states.shape[:-1] or happens.dtype != bool:
            raise InputError(
                f"event {name}: bool [..., {steps}] is wanted, not {happens.dtype} "
                f"{list(happens.shape)}"
            )
        happens &= states[..., 0] != ABSENT
        step = happens.argmax(axis=-1)
        first.append(jnp.where(happens.any(axis=-1), step, steps))
    return jnp.stack(first).astype(jnp.int32)


def _checked(
    samples: Any, observed: Any, pairs: Any, settings: dict[str, Any]
) -> tuple[SymbolSettings, Array, np.ndarray | None]:
    """Settings; centred paths [k, N, T + 1, 2] from the last positions observed on; pairs."""
    refuse_masked({"samples": samples, "observed": observed})
    shape = np.shape(samples)
    seen = np.shape(observed)
    if len(shape) != 4 or len(seen) != 3 or shape[1] != seen[0]:
        raise InputError(
            "samples must be [k, N, T, 2] and observed [N, obs_len, 2], not "
            f"{list(shape)} and {list(seen)}"
        )
    positions = observed if isinstance(observed, jax.Array) else np.asarray(observed)
    last = positions[:, -1]
    if isinstance(last, np.ndarray):
        # Far from the origin float32 would lose the differences.
        origin = last.astype(np.float64).mean(axis=0, where=~np.isnan(last))
        samples = samples - origin
        last = last - origin
    last = jnp.asarray(last, float)
    start = jnp.broadcast_to(last[:, None], (*shape[:2], 1, 2))
    if pairs is not None:
        pairs = np.asarray(pairs, int).reshape(-1, 2)
        if not np.isin(pairs, range(seen[0])).all():
            raise InputError(f"pairs must name people by 0 to {seen[0] - 1}")
    paths = jnp.concatenate([start, jnp.asarray(samples, float)], axis=2)
    return from_json(SymbolSettings, settings, "symbols"), paths, pairs


def _ends(paths: Array, pairs: Array | None) -> tuple[Array, Array, Array]:
    """Paths of k and of l, which broadcast, and [P] or [N, N] whether they are two agents."""
    if pairs is None:
        return paths[:, :, None], paths[:, None], ~jnp.eye(paths.shape[1], dtype=bool)
    k, l = pairs.T
    return paths[:, k], paths[:, l], k != l


@program((0,))
def _forecast(settings: SymbolSettings, paths: Array, pairs: Array | None) -> Array:
    k, l, others = _ends(paths, pairs)
    rows = state_steps(settings, k, l)
    count = rows[0].size
    size = len(settings.states)
    number = jnp.arange(count).reshape(1, *rows.shape[1:])
    place = (size + 1) * number + rows
    counts = jnp.zeros(count * (size + 1)).at[place.ravel()].add(1)
    # The last: samples without a state.
    counts = counts.reshape(*rows.shape[1:], size + 1)
    present = len(rows) - counts[..., -1:]
    shares = _smoothed(counts[..., :-1], present, size, settings.smoothing)
    return jnp.where(others[..., None, None], shares, 0)


def _smoothed(counts: Array, samples: Array, classes: int, smoothing: float) -> Array:
    """Probabilities by the module's formula from counts in `samples [...]`; else 0."""
    total = jnp.where(samples > 0, samples + smoothing, 1)
    shares = (counts + smoothing * (1 / classes)) / total
    return jnp.where(samples > 0, shares, 0)


@program((0, 1))
def _events(
    settings: SymbolSettings, names: tuple[str, ...], paths: Array, pairs: Array | None
) -> EventForecast:
    k, l, others = _ends(paths, pairs)
    first = jnp.sort(event_steps(settings, names, k, l), axis=1)
    count = (first < paths.shape[2] - 1).sum(axis=1)
    present = (~absent_steps(k, l)).any(axis=-1).sum(axis=0)
    share = _smoothed(count, present[None], 2, settings.smoothing)
    # The time of rank ceil(q n) among n: an observed time, not one between two.
    times = []
    for quarter in (1, 2, 3):
        rank = jnp.maximum(-(-quarter * count // 4) - 1, 0)
        time = jnp.take_along_axis(first, rank[:, None], axis=1)
        times.append(time[:, 0])
    seconds = settings.period * (jnp.stack(times, axis=-1) + 1.0)
    happens = others[None] & (count > 0)
    return EventForecast(
        jnp.where(others[None], share, 0),
        jnp.where(happens[..., None], seconds, jnp.inf),
    )


def format_pairs(codes: np.ndarray, people: np.ndarray, period: float) -> str:
    """A line for every unordered pair of `people [N]`: its state at each step, `.` if unchanged.

    `codes [N, N, T - 1]` are those of QTC_C1, a step every `period` seconds; an absent
    state is blank.
    """
    texts = [*state_texts(), ""]
    head = [f"{period * (step + 1):>5.1f}" for step in range(codes.shape[-1])]
    ends = list(zip(*np.triu_indices(len(people), 1)))
    pairs = [printable(f"({people[i]}, {people[j]})") for i, j in ends]
    width = max(len("pair (k, l)     s"), *map(len, pairs))
    lines = [f"{'pair (k, l)':{width - 1}}s " + " ".join(head)]
    for (i, j), pair in zip(ends, pairs):
        steps = itertools.pairwise([-1, *codes[i, j]])
        cells = ("." if now == last else texts[now] for last, now in steps)
        row = " ".join(f"{cell:>5}" for cell in cells)
        lines.append(f"{pair:{width}} {row}")
    return "\n".join(lines)


def forecast_rows(
    samples: ArrayLike,
    observed: ArrayLike,
    people: np.ndarray,
    settings: SymbolSettings,
) -> list[dict[str, Any]]:
    """A row for each ordered pair of `people [N]`: its events, and its likeliest state by step.

    The state is None where a person is not there. The pair with the most probable event
    comes first. See `symbolic_forecast` for `samples [k, N, T, 2]` and `observed [N,
    obs_len, 2]`.
    """
    fields = dataclasses.asdict(settings)
    states = np.asarray(symbolic_forecast(samples, observed, **fields))
    events = jax.tree.map(np.asarray, symbolic_events(samples, observed, **fields))
    texts = state_texts(settings.calculus, settings.distances)
    surest = events.probability.max(axis=0)
    rows = []
    pairs = itertools.permutations(range(len(people)), 2)
    for k, l in sorted(pairs, key=lambda pair: -surest[pair]):
        happens = {}
        for name, share, times in zip(
            EVENTS, events.probability[:, k, l], events.seconds[:, k, l]
        ):
            seconds = None
            if np.isfinite(times[0]):
                seconds = np.round(times.astype(float), 3).tolist()
            happens[name] = {"probability": round(float(share), 4), "seconds": seconds}
        likely = []
        for share in states[k, l]:
            state = texts[share.argmax()] if share.any() else None
            probability = round(float(share.max()), 4)
            likely.append({"state": state, "probability": probability})
        row = {
            "k": people[k].item(),
            "l": people[l].item(),
            "period": settings.period,
            "events": happens,
            "states": likely,
        }
        rows.append(row)
    return rows


def format_forecast(rows: list[dict[str, Any]], at_least: float = 0.3) -> str:
    """The events of `forecast_rows` of at least this probability, the most probable first.

    A time is the median of the first happening, with its quartiles.
    """
    lines = ["event                                    probability  in s (quartiles)"]
    events = []
    for row in rows:
        for name, event in row["events"].items():
            if event["probability"] >= at_least:
                words = printable(EVENTS[name].in_short(name).format(**row))
                events.append((event["probability"], words, event["seconds"]))
    for probability, words, seconds in sorted(events, key=lambda event: -event[0]):
        times = "-"
        if seconds:
            early, median, late = seconds
            times = f"{median:.1f} ({early:.1f} to {late:.1f})"
        lines.append(f"{words:40} {probability:11.2f}  {times}")
    return "\n".join(
        lines if events else [*lines, f"none is as probable as {at_least:g}"]
    )
