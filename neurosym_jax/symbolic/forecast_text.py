"""Forecast states and events of a scene's pairs, as arrays, as text and as rows of JSON."""

import dataclasses
from typing import Any

import numpy as np
from jax.typing import ArrayLike

from neurosym_jax.symbolic.calculi import CALCULI
from neurosym_jax.symbolic.description import state_texts
from neurosym_jax.symbolic.events import EVENTS, in_short
from neurosym_jax.symbolic.forecast import symbolic_events, symbolic_forecast
from neurosym_jax.symbolic.futures import SymbolSettings

__all__ = ["PairForecasts", "forecast_pairs", "forecast_rows", "format_forecast"]


@dataclasses.dataclass(frozen=True, eq=False)
class PairForecasts:
    """Probabilities of the states and events of a scene's ordered pairs."""

    settings: SymbolSettings
    people: np.ndarray
    """[N] ids."""
    states: np.ndarray
    """[N, N, T, S] probabilities in the order of the calculus's `states`."""
    symbols: np.ndarray
    """[N, N, T, m, V] see `forecast.SymbolicForecast`."""
    events: tuple[str, ...]
    """Names of E events."""
    probability: np.ndarray
    """[E, N, N] of the events."""
    seconds: np.ndarray
    """[E, N, N, 3] quartiles of their times, infinite where they never happen."""

    @property
    def pairs(self) -> list[tuple[int, int]]:
        """Ordered pairs, those with the most probable event first."""
        surest = self.probability.max(axis=0)
        np.fill_diagonal(surest, -1)
        order = np.argsort(-surest, axis=None, kind="stable")[: len(surest) * (len(surest) - 1)]
        return [(int(place) // len(surest), int(place) % len(surest)) for place in order]


def forecast_pairs(
    samples: ArrayLike, observed: ArrayLike, people: np.ndarray, settings: SymbolSettings
) -> PairForecasts:
    """States and events of all pairs of a scene.

    Args:
        samples: [k, N, T, 2] metres.
        observed: [N, obs_len, 2] metres.
        people: [N] ids.
        settings: thresholds and smoothing.
    """
    names, how = tuple(EVENTS), dataclasses.asdict(settings)
    states = symbolic_forecast(samples, observed, **how)
    events = symbolic_events(samples, observed, events=names, **how)
    states, symbols, probability, seconds = (
        np.asarray(each, np.float64) for each in (*states, *events)
    )
    return PairForecasts(settings, people, states, symbols, names, probability, seconds)


def forecast_rows(found: PairForecasts) -> list[dict[str, Any]]:
    """A row for every ordered pair; states less probable than 1 % are left out."""
    texts = state_texts(found.settings.calculus)
    symbols = CALCULI[found.settings.calculus].symbols
    rows = []
    for i, j in found.pairs:
        steps = []
        for step, shares in enumerate(found.states[i, j]):
            order = [int(row) for row in np.argsort(-shares) if shares[row] >= 0.01]
            each = zip(symbols, found.symbols[i, j, step])
            steps.append(
                {
                    "seconds": round(found.settings.period * (step + 1), 3),
                    "states": {texts[row]: round(float(shares[row]), 4) for row in order},
                    "symbols": {name: np.round(share, 4).tolist() for name, share in each},
                }
            )
        events = {}
        for number, name in enumerate(found.events):
            times = found.seconds[number, i, j]
            events[name] = {
                "probability": round(float(found.probability[number, i, j]), 4),
                "seconds": np.round(times, 3).tolist() if np.isfinite(times).all() else None,
            }
        pair = {"k": found.people[i].item(), "l": found.people[j].item()}
        rows.append({**pair, "events": events, "steps": steps})
    return rows


def format_forecast(found: PairForecasts, at_least: float = 0.3) -> str:
    """The events of at least this probability, and the most probable states of their pairs.

    The most probable events come first; a time is the median of the first happening, with its
    quartiles.
    """
    lines = ["event                                    probability  in s (quartiles)"]
    likely = np.argwhere(found.probability >= at_least)
    surest = sorted(likely.tolist(), key=lambda at: -found.probability[tuple(at)])
    for number, i, j in surest:
        words = in_short(found.events[number]).format(k=found.people[i], l=found.people[j])
        low, median, high = found.seconds[number, i, j]
        share = found.probability[number, i, j]
        times = f"{median:.1f} ({low:.1f} to {high:.1f})" if np.isfinite(median) else "-"
        lines.append(f"{words:40} {share:11.2f}  {times}")
    if not surest:
        lines.append(f"none is as probable as {at_least:g}")
    texts, steps = state_texts(found.settings.calculus), range(found.states.shape[2])
    head = " ".join(f"{found.settings.period * (step + 1):>9.1f}" for step in steps)
    lines += ["", f"pair (k, l)    s {head}"]
    shown = {(i, j) for _, i, j in surest}
    for i, j in (pair for pair in found.pairs if pair in shown):
        best = found.states[i, j].argmax(axis=1)
        shares = 100 * found.states[i, j].max(axis=1)
        cells = (f"{texts[row]} {share:3.0f}%" for row, share in zip(best, shares))
        pair = f"({found.people[i]}, {found.people[j]})"
        lines.append(f"{pair:16} " + " ".join(f"{cell:>9}" for cell in cells))
    return "\n".join(lines)
