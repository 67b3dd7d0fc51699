"""States and events of a scene's pairs, observed and forecast, as text and rows."""

import dataclasses
import itertools
from typing import Any

import jax
import numpy as np
from jax.typing import ArrayLike

from neurosym_jax.symbolic.events import EVENTS
from neurosym_jax.symbolic.forecast import SymbolSettings, symbolic_events, symbolic_forecast
from neurosym_jax.symbolic.states import Calculus, all_states, format_state

__all__ = ["forecast_rows", "format_forecast", "format_pairs", "is_constant", "state_texts"]


def state_texts(calculus: Calculus = "c1") -> list[str]:
    """The S states of a calculus as text, such as `-+0+`; those of `c1` by their codes."""
    return [format_state(state, "") for state in all_states(calculus)]


def is_constant(alpha: np.ndarray) -> bool:
    """Whether `alpha [N, N, T]` is the same for all pairs at all steps but the first."""
    others = alpha[~np.eye(len(alpha), dtype=bool)][:, 1:]
    return others.size > 0 and np.ptp(others) == 0


def format_pairs(codes: np.ndarray, people: np.ndarray, period: float) -> str:
    """A line for every unordered pair of `people [N]`: its state at each step, `.` if unchanged.

    `codes [N, N, T - 1]` are those of QTC_C1, a step every `period` seconds.
    """
    texts = state_texts()
    head = [f"{period * (step + 1):>5.1f}" for step in range(codes.shape[-1])]
    lines = ["pair (k, l)     s " + " ".join(head)]
    for i, j in zip(*np.triu_indices(len(people), 1)):
        steps = itertools.pairwise([-1, *codes[i, j]])
        cells = ("." if now == last else texts[now] for last, now in steps)
        pair = f"({people[i]}, {people[j]})"
        lines.append(f"{pair:18}" + " ".join(f"{cell:>5}" for cell in cells))
    return "\n".join(lines)


def forecast_rows(
    samples: ArrayLike, observed: ArrayLike, people: np.ndarray, settings: SymbolSettings
) -> list[dict[str, Any]]:
    """A row for each ordered pair of `people [N]`: its events, and its likeliest state by step.

    The pair with the most probable event comes first. See `symbolic_forecast` for `samples
    [k, N, T, 2]` and `observed [N, obs_len, 2]`.
    """
    how = dataclasses.asdict(settings)
    states = np.asarray(symbolic_forecast(samples, observed, **how))
    events = jax.tree.map(np.asarray, symbolic_events(samples, observed, **how))
    texts, surest = state_texts(settings.calculus), events.probability.max(axis=0)
    rows = []
    for k, l in sorted(itertools.permutations(range(len(people)), 2), key=lambda at: -surest[at]):
        happens = {}
        for name, share, times in zip(EVENTS, events.probability[:, k, l], events.seconds[:, k, l]):
            seconds = np.round(times.astype(float), 3).tolist() if np.isfinite(times[0]) else None
            happens[name] = {"probability": round(float(share), 4), "seconds": seconds}
        likely = [
            {"state": texts[share.argmax()], "probability": round(float(share.max()), 4)}
            for share in states[k, l]
        ]
        pair = {"k": people[k].item(), "l": people[l].item(), "period": settings.period}
        rows.append(pair | {"events": happens, "states": likely})
    return rows


def format_forecast(rows: list[dict[str, Any]], at_least: float = 0.3) -> str:
    """The events of `forecast_rows` of at least this probability, the most probable first.

    A time is the median of the first happening, with its quartiles.
    """
    lines = ["event                                    probability  in s (quartiles)"]
    found = [
        (event["probability"], EVENTS[name].in_short(name).format(**row), event["seconds"])
        for row in rows
        for name, event in row["events"].items()
        if event["probability"] >= at_least
    ]
    for share, words, seconds in sorted(found, key=lambda each: -each[0]):
        times = "{1:.1f} ({0:.1f} to {2:.1f})".format(*seconds) if seconds else "-"
        lines.append(f"{words:40} {share:11.2f}  {times}")
    return "\n".join(lines if found else [*lines, f"none is as probable as {at_least:g}"])
