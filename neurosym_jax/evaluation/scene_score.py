"""Scores of the forecast of one scene, in any frame."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from jax.typing import ArrayLike

from neurosym_jax.data.batching import bucket_of
from neurosym_jax.evaluation.scoring import Scores, chosen, score_scenes
from neurosym_jax.scene import Scene, model_dtype

__all__ = ["score"]


def score(
    forecast: ArrayLike,
    future: ArrayLike,
    valid: ArrayLike | None = None,
    *,
    observed: ArrayLike | None = None,
    extras: Mapping[str, ArrayLike] | None = None,
    metrics: Sequence[str] | None = None,
    probability: ArrayLike | None = None,
) -> Scores:
    """Scores of one scene, S = 1.

    Args:
        forecast: [k, N, T, 2] metres in any frame.
        future: [N, T, 2] metres in the same frame, the truth.
        valid: [N] bool, agents that count; positions of the others are ignored.
        observed: [N, obs_len, 2] metres in the same frame, for metrics of symbols.
        extras: [N, ...] of each agent by name, for metrics that ask for them.
        metrics: names; by default those that are computed without being named.
        probability: [k] of the samples; default: all have the same.
    """
    forecast, future = np.asarray(forecast, np.float64), np.asarray(future, np.float64)
    present = np.ones(len(future), bool) if valid is None else np.asarray(valid)
    # A program for each bucket, not for each number of people; and no loss far from the origin.
    slots = int(bucket_of(len(present)))
    origin = future[present].mean(axis=(0, 1)) if present.any() else np.zeros(2)
    seen = np.zeros((len(future), 1, 2)) if observed is None else np.asarray(observed, np.float64)

    def padded(values: ArrayLike, dtype: Any = None) -> np.ndarray:
        """[1, slots, ...] of `values [N, ...]`, zero where no agent counts."""
        values = np.asarray(values)
        array = np.zeros((1, slots, *values.shape[1:]), dtype or values.dtype)
        array[0, : len(present)][present] = values[present]
        return array

    dtype = model_dtype()
    scene = Scene(
        observed=padded(seen - origin, dtype),
        displacement=padded(np.diff(seen, axis=1, prepend=seen[:, :1]), dtype),
        valid=padded(present),
        identity=np.zeros((1, 2), np.uint32),
        origin=None,
        future=padded(future - origin, dtype),
        extras={name: padded(values) for name, values in (extras or {}).items()},
    )
    samples = np.stack([padded(sample - origin, dtype) for sample in forecast])
    likely = None if probability is None else np.asarray(probability, dtype)[:, None]
    return score_scenes(chosen(metrics), {"samples": samples}, scene, likely)
