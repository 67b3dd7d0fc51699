"""Scores of a trained network over all people, and over those who interact.

A person interacts if, in the observation, another person within 2 m comes nearer by more than 5 cm
over the last observed step of 0.4 s, which is more than the trackers' noise.
"""

from collections import defaultdict
from typing import Any

import jax
import numpy as np

from neurosym_jax.data.batching import make_batches
from neurosym_jax.data.windows import Windows
from neurosym_jax.evaluation.bootstrap import ErrorsByScene
from neurosym_jax.evaluation.scoring import chosen, score_scenes
from neurosym_jax.forecasting.batched import batch_noise, forecast_batch, unpacked
from neurosym_jax.forecasting.networks import GeneratorForecaster
from neurosym_jax.models.config import GeneratorConfig

__all__ = ["JOINT", "interacting", "score"]

NEAR, NEARER = 2.0, 0.05
"""Metres to a neighbour, and that the distance has to shrink by in the last step."""

JOINT = ("joint_ade", "energy_score", "joint_fde", "central_ade")
"""Metrics of both groups; `excess_collisions` are computed over all people only."""


def interacting(observed: np.ndarray, valid: np.ndarray) -> np.ndarray:
    """[..., N] bool: who interacts; of `observed [..., N, T, 2]` metres, `valid [..., N]`."""
    before, last = (
        np.linalg.norm(observed[..., :, None, at, :] - observed[..., None, :, at, :], axis=-1)
        for at in (-2, -1)
    )
    others = valid[..., :, None] & valid[..., None, :] & ~np.eye(valid.shape[-1], dtype=bool)
    return (others & (last < NEAR) & (before - last > NEARER)).any(axis=-1)


def score(
    generator: GeneratorConfig, params: Any, windows: Windows, *, samples: int = 20, seed: int = 0
) -> ErrorsByScene:
    """Scores on every scene of `windows`; metrics are named `interacting joint_ade`, `all ...`.

    Args:
        generator: the network.
        params: its parameters.
        windows: the test set.
        samples: k.
        seed: of the noise.
    """
    forecaster, params = GeneratorForecaster(generator), jax.device_put(params)
    found: dict[str, np.ndarray] = defaultdict(lambda: np.zeros((2, windows.scenes)))
    for batch in make_batches(windows):
        valid, there = np.asarray(batch.scene.valid), batch.index >= 0
        noise = batch_noise(forecaster, batch.scene, samples, seed)
        futures, _ = forecast_batch(forecaster, params, batch.scene, noise)
        places = unpacked(futures, valid)
        near = interacting(np.asarray(batch.scene.observed), valid)
        for group, who, names in (
            ("interacting", near, JOINT),
            ("all", valid, (*JOINT, "excess_collisions")),
        ):
            counted = batch.scene.replace(valid=who)
            for name, of in score_scenes(chosen(names), places, counted).items():
                found[f"{group} {name}"][:, batch.index[there]] = np.stack(of)[:, there]
    totals, counts = np.stack(list(found.values()), axis=-1)
    steps = windows.position.shape[1]
    return ErrorsByScene(tuple(found), totals, counts, windows.identity, steps)
