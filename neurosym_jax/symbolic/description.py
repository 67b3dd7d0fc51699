"""Observed states and weights of a scene's pairs, as arrays and as text."""

import dataclasses
from typing import Any

import jax
import numpy as np

from neurosym_jax.scene import make_scene
from neurosym_jax.symbolic.calculi import CALCULI
from neurosym_jax.symbolic.states import format_state
from neurosym_jax.symbolic.weighting import Weighting

__all__ = ["ScenePairs", "describe_pairs", "format_pairs", "format_shares", "state_texts"]


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

    @jax.jit
    def describe(positions: Any) -> Any:
        return weighting.codes(parameters, positions), weighting.alpha(parameters, positions)

    codes, alpha = map(np.asarray, describe(make_scene(position).observed))
    return ScenePairs(position, people, codes, alpha, period)


def state_texts(calculus: str = "c1") -> list[str]:
    """The S states of a calculus as text, such as `-+0+`; those of `c1` by their codes."""
    return [format_state(state, "") for state in CALCULI[calculus].states]


def format_pairs(pairs: ScenePairs) -> str:
    """A line for every unordered pair: its state at each step, `.` where it does not change."""
    texts = state_texts()
    head = [f"{pairs.period * (step + 1):>5.1f}" for step in range(pairs.codes.shape[-1])]
    lines = ["pair (k, l)     s " + " ".join(head)]
    for i in range(len(pairs.people)):
        for j in range(i + 1, len(pairs.people)):
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
