"""What the pairs of a scene will do, as text and as rows of JSON."""

import dataclasses
from typing import Any

import numpy as np
from jax.typing import ArrayLike

from neurosym_jax.symbolic.calculi import CALCULI
from neurosym_jax.symbolic.cnd import states
from neurosym_jax.symbolic.events import EVENTS, in_short
from neurosym_jax.symbolic.forecast import symbolic_events, symbolic_forecast
from neurosym_jax.symbolic.futures import settings_of
from neurosym_jax.symbolic.states import format_state

__all__ = ["PairForecasts", "forecast_pairs", "forecast_rows", "format_forecast"]


@dataclasses.dataclass(frozen=True, eq=False)
class PairForecasts:
    """What is forecast of a scene's ordered pairs."""

    people: np.ndarray
    """[N] ids."""
    calculus: str
    period: float
    """Seconds between steps."""
    states: np.ndarray
    """[N, N, T, S] probabilities in the order of `cnd.states`."""
    symbols: np.ndarray
    """[N, N, T, m, V] see `forecast.SymbolicForecast`."""
    events: tuple[str, ...]
    """Names."""
    probability: np.ndarray
    """[E, N, N] of the events."""
    seconds: np.ndarray
    """[E, N, N, 3] quartiles of their times, infinite where they never happen."""

    @property
    def texts(self) -> list[str]:
        """Of the S states, such as `-+0+`."""
        return [format_state(state, "") for state in states(self.calculus)]

    @property
    def pairs(self) -> list[tuple[int, int]]:
        """Ordered pairs, those first to whom an event is most probable."""
        surest = self.probability.max(axis=0)
        np.fill_diagonal(surest, -1)
        order = np.argsort(-surest, axis=None, kind="stable")[: len(surest) * (len(surest) - 1)]
        return [(int(place) // len(surest), int(place) % len(surest)) for place in order]


def forecast_pairs(
    samples: ArrayLike, observed: ArrayLike, people: np.ndarray, **settings: Any
) -> PairForecasts:
    """Symbols and events of all pairs of a scene.

    Args:
        samples: [k, N, T, 2] metres.
        observed: [N, obs_len, 2] metres.
        people: [N] ids.
        **settings: see `futures.SymbolSettings`.
    """
    how = settings_of(settings)
    names = tuple(EVENTS)
    of_states = symbolic_forecast(samples, observed, **settings)
    of_events = symbolic_events(samples, observed, events=names, **settings)
    return PairForecasts(
        people,
        how.calculus,
        how.period,
        np.asarray(of_states.states, np.float64),
        np.asarray(of_states.symbols, np.float64),
        names,
        np.asarray(of_events.probability, np.float64),
        np.asarray(of_events.seconds, np.float64),
    )


def forecast_rows(found: PairForecasts) -> list[dict[str, Any]]:
    """A row for every ordered pair; states less probable than 1 % are left out."""
    texts, symbols = found.texts, CALCULI[found.calculus].symbols
    rows = []
    for i, j in found.pairs:
        steps = []
        for step, shares in enumerate(found.states[i, j]):
            order = [int(row) for row in np.argsort(-shares) if shares[row] >= 0.01]
            each = zip(symbols, found.symbols[i, j, step])
            steps.append(
                {
                    "seconds": round(found.period * (step + 1), 3),
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
    """The events that are `at_least` so probable, and the most probable states of their pairs.

    The most probable events come first; a time is the median of the first happening, with its
    quartiles.
    """
    lines = ["event                                    probability  in s (quartiles)"]
    told = np.argwhere(found.probability >= at_least)
    surest = sorted(told.tolist(), key=lambda at: -found.probability[tuple(at)])
    for number, i, j in surest:
        words = in_short(found.events[number]).format(k=found.people[i], l=found.people[j])
        low, median, high = found.seconds[number, i, j]
        share = found.probability[number, i, j]
        times = f"{median:.1f} ({low:.1f} to {high:.1f})" if np.isfinite(median) else "-"
        lines.append(f"{words:40} {share:11.2f}  {times}")
    if not surest:
        lines.append(f"none is as probable as {at_least:g}")
    texts, steps = found.texts, range(found.states.shape[2])
    head = " ".join(f"{found.period * (step + 1):>9.1f}" for step in steps)
    lines += ["", f"pair (k, l)    s {head}"]
    shown = {(i, j) for _, i, j in surest}
    for i, j in found.pairs:
        if (i, j) in shown:
            best = found.states[i, j].argmax(axis=1)
            cells = (
                f"{texts[row]} {100 * found.states[i, j, t, row]:3.0f}%"
                for t, row in enumerate(best)
            )
            pair = f"({found.people[i]}, {found.people[j]})"
            lines.append(f"{pair:16} " + " ".join(f"{cell:>9}" for cell in cells))
    return "\n".join(lines)
