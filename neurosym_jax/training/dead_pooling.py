"""The neighbour effect at each validation, and the warning when a pooling is dead."""

import functools
import sys
from collections.abc import Mapping, Sequence
from typing import Any

import jax
import numpy as np

from neurosym_jax.data.batching import Batch
from neurosym_jax.evaluation.scoring import Evaluation
from neurosym_jax.forecasting.networks import interact_scene
from neurosym_jax.models import Generator
from neurosym_jax.models.config import GeneratorConfig
from neurosym_jax.scene import Scene

__all__ = [
    "EFFECT",
    "neighbour_effect",
    "silent_units",
    "warn_if_dead",
    "warn_if_no_gradient",
]

EFFECT = ("neighbour_share", "neighbour_near", "neighbour_move")
"""The metrics of a validation by which a pooling is judged."""
LEAST = 0.5
"""Least share of people with somebody within 2 m whom a living pooling changes."""


def neighbour_effect(
    result: Evaluation, config: Any, params: Any, batches: Sequence[Batch]
) -> dict[str, float]:
    """The part of a validation's row: each metric of `EFFECT` that has a value, and silent units.

    Args:
        result: with the metrics of `EFFECT`, or without them: then there is nothing.
        config: of the forecaster.
        params: its parameters.
        batches: the validation windows.
    """
    row = {f"val_{name}": result.mean(name) for name in EFFECT if name in result.scores}
    if row and isinstance(config, GeneratorConfig):
        silent = silent_units(config, params, batches)
        row |= {"val_silent_units": int(silent.sum()), "val_units": len(silent)}
    return {name: value for name, value in row.items() if np.isfinite(value)}


def silent_units(config: GeneratorConfig, params: Any, batches: Sequence[Batch]) -> np.ndarray:
    """[B] bool, the pooled numbers that are above 0 for nobody in `batches`."""
    scenes = [batch.scene.bare() for batch in batches]
    return ~np.any([_above_zero(config, params, scene) for scene in scenes], axis=0)


@functools.partial(jax.jit, static_argnums=0)
def _above_zero(config: GeneratorConfig, params: Any, scenes: Scene) -> jax.Array:
    def of_scene(scene: Scene) -> jax.Array:
        hidden = Generator(config).apply(params, scene.displacement, method=Generator.observe)
        pooled = interact_scene(config, params, hidden, scene, method=Generator.pool)
        return (pooled > 0) & scene.valid[:, None]

    return jax.vmap(of_scene)(scenes).any(axis=(0, 1))


def warn_if_dead(row: Mapping[str, Any]) -> None:
    """Print a warning if the pooling of a validation's `row` is dead."""
    if not row.get("val_neighbour_near", 1.0) < LEAST:
        return
    text = f"{100 * row['val_neighbour_share']:.0f} % of people are changed by their neighbours"
    if "val_units" in row:
        silent, units = row["val_silent_units"], row["val_units"]
        text += f": {silent} of {units} bottleneck units are never above 0"
    print(f"warning: dead pooling at step {row['step']}: {text}", file=sys.stderr)


def warn_if_no_gradient(gradient: Any, by: str) -> None:
    """Print a warning if a gradient by weights, called `by`, is 0 in every entry."""
    if not any(np.any(leaf) for leaf in jax.tree.leaves(gradient)):
        print(
            f"warning: the gradient by {by} is 0 in every entry: the network is dead to its "
            "neighbours",
            file=sys.stderr,
        )
