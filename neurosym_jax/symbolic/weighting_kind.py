"""What a kind of weighting is: how alpha is computed, and what a configuration can ask for."""

import dataclasses
from collections.abc import Callable, Iterable, Mapping
from typing import Any

import numpy as np
from jax import Array
from jax.typing import ArrayLike

__all__ = ["Parameters", "Scenes", "WeightingKind"]

Parameters = Mapping[str, Any]
"""What a weighting learns or estimates, by name; it lies in `params["weighting"]` of a model."""

Scenes = Iterable[tuple[Any, Any]]
"""Batches (positions [B, N, T, 2] metres, valid [B, N]) of the observed part of scenes."""


@dataclasses.dataclass(frozen=True)
class WeightingKind:
    """A kind of weighting: how alpha is computed, and what a configuration of it can ask for.

    What an agent weighs for itself, in padding or alone is not its business (`scene_alpha`).
    """

    weigh: Callable[[Any, Parameters, Array, ArrayLike | None], Array]
    """`(config, parameters, positions [N, T, 2], valid [N] or None) -> alpha [N, N, T]`."""
    start: Callable[[Any, Scenes | None], Parameters] = lambda config, scenes: {}
    """What its parameters are before training; scenes are those it is trained on, where known."""
    table: Callable[[Any], np.ndarray] | None = None
    """[81] weights of the QTC_C1 states by code before training, where it looks them up."""
    learnable: bool = False
    """Whether training can change it."""
    learned: bool = False
    """Whether training does so unless it is told otherwise."""
    learns_quantisation: bool = False
    """Whether its threshold is a parameter, by its logarithm."""
    quantisation_factor: float = 0.0
    """Of the symbols, in metres a step, unless a configuration has another."""
