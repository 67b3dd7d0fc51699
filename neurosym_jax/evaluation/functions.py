"""Predictors that are functions of numpy or torch, called for every scene of a test set."""

import time
from collections.abc import Callable
from typing import Any

import numpy as np

from neurosym_jax.data.windows import Windows
from neurosym_jax.errors import InputError
from neurosym_jax.evaluation.forecasts import Forecasts

__all__ = ["Predictor", "predict_windows"]

Predictor = Callable[[np.ndarray], Any]
"""`predictor(observed [N, obs_len, 2])` returns [N, T, 2] or [k, N, T, 2], of one scene, metres;
or a pair of the latter and probabilities [k]."""


def predict_windows(predictor: Predictor, name: str, windows: Windows) -> Forecasts:
    """Call a predictor for every scene of `windows`.

    Raises:
        InputError: naming the predictor, for what is no forecast of the scene.
    """
    pred_len, parts, seconds = windows.position.shape[1] - windows.obs_len, [], []
    for at, people in enumerate(windows.sizes):
        scene = windows.position[slice(*windows.bounds[at : at + 2]), : windows.obs_len]
        start = time.perf_counter()
        answer = predictor(scene.copy())
        seconds.append(time.perf_counter() - start)
        samples, likely = answer if isinstance(answer, tuple) else (answer, None)
        samples = np.asarray(_on_host(samples), np.float64)
        samples = samples[None] if samples.ndim == 3 else samples
        count = len(parts[0][0]) if parts else len(samples)
        if (
            samples.shape != (count, people, pred_len, 2)
            or not np.isfinite(samples).all()
        ):
            raise InputError(
                f"{name}: must return finite [{people}, {pred_len}, 2] or "
                f"[k, {people}, {pred_len}, 2], k the same for all scenes, not "
                f"{list(samples.shape)}"
            )
        if likely is not None:
            likely = np.asarray(_on_host(likely), np.float64)
            if likely.shape != (count,) or not np.isclose(likely.sum(), 1, atol=1e-3):
                raise InputError(
                    f"{name}: probabilities must be [{count}] with a sum of 1"
                )
        parts.append((samples, likely))
    samples, likely = zip(*parts)
    probability = (
        None if any(weights is None for weights in likely) else np.stack(likely, axis=1)
    )
    return Forecasts(
        name, np.concatenate(samples, axis=1), probability, float(np.median(seconds))
    )


def _on_host(array: Any) -> Any:
    """A torch tensor without its gradient, for numpy."""
    return array.detach().cpu() if hasattr(array, "detach") else array
