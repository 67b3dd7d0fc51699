"""The tables that a sweep's models have learned, and whether seeds agree on them."""

import itertools
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from neurosym_jax.forecasting.model_folder import load_model
from neurosym_jax.symbolic.built_in import table_of
from neurosym_jax.symbolic.states import decode_state

__all__ = ["agreement", "learned_changes"]


def learned_changes(rows: Sequence[dict[str, Any]]) -> dict[str, dict[str, list[list[float]]]]:
    """What training added to the 16 states without a zero, by model, test set and seed.

    People are hardly ever in the other states, so that their weights stay where they start.
    """
    changes: dict[str, dict[str, list[list[float]]]] = {}
    often = (np.asarray(decode_state(np.arange(81))) != 0).all(axis=1)
    for row in sorted(rows, key=lambda row: row["run"]["seed"]):
        model = load_model(Path(row["checkpoint"]))
        table = model.params.get("weighting", {}).get("table")
        # A weighting of one's own may call by that name what is none of the 81 states.
        if model.weighting is None or np.shape(table) != (81,):
            continue
        change = table - table_of(model.weighting)
        of_model = changes.setdefault(model.weighting.name, {})
        of_model.setdefault(row["scene"], []).append(change[often].round(4).tolist())
    return changes


def agreement(of_seeds: Sequence[Sequence[float]]) -> float | None:
    """Mean correlation of the changes of every two seeds; None for a single one."""
    pairs = list(itertools.combinations(np.asarray(of_seeds), 2))
    return float(np.mean([np.corrcoef(*pair)[0, 1] for pair in pairs])) if pairs else None
