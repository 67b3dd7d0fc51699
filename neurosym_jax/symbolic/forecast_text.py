"""Forecast states and events of a scene's pairs, as arrays, as text and as rows of JSON."""

import dataclasses
from typing import Any

import jax
import numpy as np
from jax.typing import ArrayLike

from neurosym_jax.symbolic.description import state_texts
from neurosym_jax.symbolic.events import EVENTS, in_short
from neurosym_jax.symbolic.forecast import EventForecast, symbolic_events, symbolic_forecast
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
    """States and events of all pairs of a scene.

    Args:
        samples: [k, N, T, 2] metres.
        observed: [N, obs_len, 2] metres.
        people: [N] ids.
        settings: thresholds and smoothing.
    """
    how = dataclasses.asdict(settings)
    states = symbolic_forecast(samples, observed, **how).states
    events = jax.tree.map(np.asarray, symbolic_events(samples, observed, **how))
    return PairForecasts(settings, people, np.asarray(states), events)


def forecast_rows(found: PairForecasts) -> list[dict[str, Any]]:
    """A row for every ordered pair: its events, and the most probable state of each step."""
    rows = []
    for i, j in found.pairs:
        events = {}
        for name, share, times in zip(
            EVENTS, found.events.probability[:, i, j], found.events.seconds[:, i, j]
        ):
            quartiles = [round(float(time), 3) for time in times]
            known = bool(np.isfinite(times).all())
            events[name] = {
                "probability": round(float(share), 4),
                "seconds": quartiles if known else None,
            }
        states = [
            {"state": text, "probability": round(share, 4)}
            for text, share in found.likely_states(i, j)
        ]
        pair = {"k": found.people[i].item(), "l": found.people[j].item()}
        rows.append({**pair, "period": found.settings.period, "events": events, "states": states})
    return rows


def format_forecast(found: PairForecasts, at_least: float = 0.3) -> str:
    """The events of at least this probability, and the most probable states of their pairs.

    The most probable events come first; a time is the median of the first happening, with its
    quartiles.
    """
    lines = ["event                                    probability  in s (quartiles)"]
    probability, names = np.asarray(found.events.probability), tuple(EVENTS)
    likely = np.argwhere(probability >= at_least).tolist()
    surest = sorted(likely, key=lambda at: -probability[tuple(at)])
    for number, i, j in surest:
        words = in_short(names[number]).format(k=found.people[i], l=found.people[j])
        low, median, high = found.events.seconds[number, i, j]
        times = f"{median:.1f} ({low:.1f} to {high:.1f})" if np.isfinite(median) else "-"
        lines.append(f"{words:40} {probability[number, i, j]:11.2f}  {times}")
    if not surest:
        lines.append(f"none is as probable as {at_least:g}")
    steps = range(found.states.shape[2])
    head = " ".join(f"{found.settings.period * (step + 1):>9.1f}" for step in steps)
    lines += ["", f"pair (k, l)    s {head}"]
    shown = {(i, j) for _, i, j in surest}
    for i, j in (pair for pair in found.pairs if pair in shown):
        cells = (f"{text} {100 * share:3.0f}%" for text, share in found.likely_states(i, j))
        pair = f"({found.people[i]}, {found.people[j]})"
        lines.append(f"{pair:16} " + " ".join(f"{cell:>9}" for cell in cells))
    return "\n".join(lines)
