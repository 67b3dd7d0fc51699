"""Symbols and weights of a scene's pairs, and of a data set's states, as arrays and as text."""

import dataclasses
import functools
from typing import Any

import jax
import numpy as np
from jax import Array

from neurosym_jax.scene import make_scene
from neurosym_jax.symbolic.states import decode_state, format_state
from neurosym_jax.symbolic.transitions import pair_codes
from neurosym_jax.symbolic.weighting import scene_alpha
from neurosym_jax.symbolic.weighting_config import WEIGHTINGS, WeightingConfig

__all__ = [
    "ScenePairs",
    "describe_pairs",
    "format_pairs",
    "format_shares",
    "state_tables",
    "state_texts",
]


@dataclasses.dataclass(frozen=True, eq=False)
class ScenePairs:
    """What a weighting sees in the pairs of a scene, and what it makes of it."""

    position: np.ndarray
    """[N, T, 2] metres."""
    people: np.ndarray
    """[N] ids."""
    codes: np.ndarray
    """[N, N, T - 1] codes of the QTC_C1 states."""
    alpha: np.ndarray
    """[N, N, T] weights."""


def describe_pairs(
    config: WeightingConfig, parameters: dict[str, Any], position: np.ndarray, people: np.ndarray
) -> ScenePairs:
    """The states and weights of a scene's pairs.

    Args:
        config: the weighting.
        parameters: what it learned or estimated, as in `params["weighting"]` of a model.
        position: [N, T, 2] metres.
        people: [N] ids.
    """
    scene = make_scene(position)

    @jax.jit
    def describe(positions: Any, valid: Any) -> tuple[Array, Array]:
        codes = pair_codes(config, positions, valid)
        return codes, scene_alpha(config, parameters, positions)

    codes, alpha = map(np.asarray, describe(scene.observed, scene.valid))
    return ScenePairs(position, people, codes, alpha)


@functools.cache
def state_texts() -> list[str]:
    """Of the 81 states of QTC_C1 by code, such as `-+0+`."""
    return [format_state(state, "") for state in np.asarray(decode_state(np.arange(81)))]


def state_tables(
    config: WeightingConfig, parameters: dict[str, Any]
) -> tuple[np.ndarray | None, np.ndarray | None]:
    """[81] weights by state before and after training, where the weighting has any."""
    table = WEIGHTINGS[config.kind].table
    return (None, None) if table is None else (table(config), parameters.get("table"))


def format_pairs(pairs: ScenePairs, period: float) -> str:
    """A line for every unordered pair: its states from step to step, `.` where they stay.

    Args:
        pairs: of a scene.
        period: seconds between steps.
    """
    steps = pairs.codes.shape[-1]
    head = [f"{period * (step + 1):>5.1f}" for step in range(steps)]
    lines = ["pair (k, l)     s " + " ".join(head)]
    for i in range(len(pairs.people)):
        for j in range(i + 1, len(pairs.people)):
            codes = pairs.codes[i, j]
            stays = np.diff(codes, prepend=-1) == 0
            texts = ["." if stay else state_texts()[code] for code, stay in zip(codes, stays)]
            pair = f"({pairs.people[i]}, {pairs.people[j]})"
            lines.append(f"{pair:18}" + " ".join(f"{text:>5}" for text in texts))
    return "\n".join(lines)


def format_shares(counts: np.ndarray) -> str:
    """Per cent of the pair-steps by how many of their symbols are 0.

    Args:
        counts: [81] pair-steps by state.
    """
    zeros = [text.count("0") for text in state_texts()]
    shares = 100 * np.bincount(zeros, counts, 5) / counts.sum()
    words = ("no symbol is 0", "one", "two", "three", "all")
    return ", ".join(f"{word} {share:.1f} %" for word, share in zip(words, shares))
