"""States and weights of a scene's pairs, observed and forecast, as arrays, text and rows."""

import dataclasses
from collections.abc import Iterable
from typing import Any

import jax
import numpy as np
from jax.typing import ArrayLike

from neurosym_jax.scene import Scene, make_scene
from neurosym_jax.symbolic.events import EVENTS
from neurosym_jax.symbolic.forecast import (
    EventForecast,
    SymbolSettings,
    symbolic_events,
    symbolic_forecast,
)
from neurosym_jax.symbolic.qtc import other_pairs
from neurosym_jax.symbolic.states import all_states, format_state
from neurosym_jax.symbolic.weighting import Weighting

__all__ = [
    "PairForecasts",
    "ScenePairs",
    "count_states",
    "describe_pairs",
    "forecast_pairs",
    "forecast_rows",
    "format_forecast",
    "format_pairs",
    "format_shares",
    "state_texts",
]


@dataclasses.dataclass(frozen=True, eq=False)
class ScenePairs:
    """States and weights of the pairs of a scene."""

    position: np.ndarray
    """[N, T, 2] metres."""
    people: np.ndarray
    """[N] ids."""
    codes: np.ndarray
    """[N, N, T - 1] codes of the QTC_C1 states, as the weighting observes them."""
    alpha: np.ndarray
    """[N, N, T] weights."""
    period: float
    """Seconds between steps."""

    @property
    def constant(self) -> bool:
        """Whether alpha is the same for all pairs at all steps but the first."""
        others = self.alpha[~np.eye(len(self.alpha), dtype=bool)][:, 1:]
        return others.size > 0 and np.ptp(others) == 0


def describe_pairs(
    weighting: Weighting,
    parameters: dict[str, Any],
    position: np.ndarray,
    people: np.ndarray,
    period: float,
) -> ScenePairs:
    """The pairs of the scene `position [N, T, 2]`; `parameters` are the weighting's."""
    observed = make_scene(position).observed
    codes, alpha = weighting.codes(parameters, observed), weighting.alpha(parameters, observed)
    return ScenePairs(position, people, np.asarray(codes), np.asarray(alpha), period)


def count_states(
    weighting: Weighting, parameters: dict[str, Any], batches: Iterable[Scene]
) -> np.ndarray:
    """[81] int64: pair-steps in each state, as the weighting observes them."""

    @jax.jit
    @jax.vmap
    def observe(scene: Scene) -> tuple[Any, Any]:
        others = other_pairs(scene.valid, len(scene.valid))
        return weighting.codes(parameters, scene.observed), others

    total = np.zeros(81, np.int64)
    for batch in batches:
        codes, others = map(np.asarray, observe(batch.bare()))
        total += np.bincount(codes[others].ravel(), minlength=81)
    return total


def state_texts(calculus: str = "c1") -> list[str]:
    """The S states of a calculus as text, such as `-+0+`; those of `c1` by their codes."""
    return [format_state(state, "") for state in all_states(calculus)]


def format_pairs(pairs: ScenePairs) -> str:
    """A line for every unordered pair: its state at each step, `.` where it does not change."""
    texts = state_texts()
    head = [f"{pairs.period * (step + 1):>5.1f}" for step in range(pairs.codes.shape[-1])]
    lines = ["pair (k, l)     s " + " ".join(head)]
    for i, j in zip(*np.triu_indices(len(pairs.people), 1)):
        codes = pairs.codes[i, j]
        stays = np.diff(codes, prepend=-1) == 0
        cells = ("." if stay else texts[code] for code, stay in zip(codes, stays))
        pair = f"({pairs.people[i]}, {pairs.people[j]})"
        lines.append(f"{pair:18}" + " ".join(f"{cell:>5}" for cell in cells))
    return "\n".join(lines)


def format_shares(counts: np.ndarray) -> str:
    """Per cent of the pair-steps by number of zero symbols, from `counts [81]` by state."""
    zeros = [text.count("0") for text in state_texts()]
    shares = 100 * np.bincount(zeros, counts, 5) / counts.sum()
    words = ("no symbol is 0", "one", "two", "three", "all")
    return ", ".join(f"{word} {share:.1f} %" for word, share in zip(words, shares))


@dataclasses.dataclass(frozen=True, eq=False)
class PairForecasts:
    """Probabilities of the states and events of a scene's ordered pairs."""

    settings: SymbolSettings
    people: np.ndarray
    """[N] ids."""
    states: np.ndarray
    """[N, N, T, S] probabilities in the order of the calculus's states."""
    events: EventForecast
    """Arrays [E, N, N, ...] of all `EVENTS`."""

    @property
    def pairs(self) -> list[tuple[int, int]]:
        """Ordered pairs, those with the most probable event first."""
        surest = np.max(self.events.probability, axis=0)
        pairs = np.argwhere(~np.eye(len(surest), dtype=bool)).tolist()
        return sorted(((i, j) for i, j in pairs), key=lambda pair: -surest[pair])

    def likely_states(self, i: int, j: int) -> list[tuple[str, float]]:
        """The most probable state of each step, as text, and its probability."""
        texts, states = state_texts(self.settings.calculus), self.states[i, j]
        return [(texts[row], float(share[row])) for row, share in zip(states.argmax(1), states)]


def forecast_pairs(
    samples: ArrayLike, observed: ArrayLike, people: np.ndarray, settings: SymbolSettings
) -> PairForecasts:
    """States and events of all pairs of a scene of `people [N]`, see `symbolic_forecast`."""
    how = dataclasses.asdict(settings)
    states = np.asarray(symbolic_forecast(samples, observed, **how))
    events = jax.tree.map(np.asarray, symbolic_events(samples, observed, **how))
    return PairForecasts(settings, people, states, events)


def forecast_rows(found: PairForecasts) -> list[dict[str, Any]]:
    """A row for every ordered pair: its events, and the most probable state of each step."""
    rows = []
    for i, j in found.pairs:
        shares, seconds = found.events.probability[:, i, j], found.events.seconds[:, i, j]
        events = {
            name: {
                "probability": round(float(share), 4),
                "seconds": [round(float(time), 3) for time in times]
                if np.isfinite(times).all()
                else None,
            }
            for name, share, times in zip(EVENTS, shares, seconds)
        }
        states = [
            {"state": text, "probability": round(share, 4)}
            for text, share in found.likely_states(i, j)
        ]
        pair = {"k": found.people[i].item(), "l": found.people[j].item()}
        rows.append({**pair, "period": found.settings.period, "events": events, "states": states})
    return rows


def format_forecast(found: PairForecasts, at_least: float = 0.3) -> str:
    """The events of at least this probability, the most probable first.

    A time is the median of the first happening, with its quartiles.
    """
    lines = ["event                                    probability  in s (quartiles)"]
    probability, names = np.asarray(found.events.probability), tuple(EVENTS)
    likely = np.argwhere(probability >= at_least).tolist()
    for number, i, j in sorted(likely, key=lambda at: -probability[tuple(at)]):
        words = EVENTS[names[number]].in_short(names[number])
        words = words.format(k=found.people[i], l=found.people[j])
        low, median, high = found.events.seconds[number, i, j]
        times = f"{median:.1f} ({low:.1f} to {high:.1f})" if np.isfinite(median) else "-"
        lines.append(f"{words:40} {probability[number, i, j]:11.2f}  {times}")
    if not likely:
        lines.append(f"none is as probable as {at_least:g}")
    return "\n".join(lines)
