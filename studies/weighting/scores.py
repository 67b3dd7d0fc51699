"""Scores of a trained network over groups of people, and how many it moves for their neighbours.

A person interacts if, in the observation, another person within 2 m comes nearer by
more than 5 cm over the last observed step of 0.4 s, which is more than the trackers'
noise. The other groups are those to whom an event happens in the true future.
"""

import functools
import itertools
from collections import defaultdict
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from neurosym_jax.data.windows import Windows, make_batches
from neurosym_jax.evaluation.scoring import chosen, score_forecaster, score_scenes
from neurosym_jax.forecasting.batched import batch_noise, forecast_batch, unpacked
from neurosym_jax.forecasting.forecaster import forecaster_of
from neurosym_jax.scene import Scene
from neurosym_jax.symbolic.forecast import SymbolSettings, event_steps

__all__ = ["groups_of", "interacting", "score"]

NEAR, NEARER = 2.0, 0.05
"""Metres to a neighbour, and that the distance has to shrink by in the last step."""

EVENTS = {
    "crossing": ("crosses_before", "crosses_behind"),
    "passing": ("passes_left", "passes_right"),
    "following": ("follows",),
    "overtaking": ("overtakes",),
}
"""Events of each group."""

METRICS = {
    "interacting": ("joint_ade", "energy_score", "joint_fde", "central_ade"),
    "all": (
        "joint_ade",
        "energy_score",
        "joint_fde",
        "central_ade",
        "excess_collisions",
    ),
    **dict.fromkeys(EVENTS, ("joint_ade", "energy_score")),
}


def interacting(observed: np.ndarray, valid: np.ndarray) -> np.ndarray:
    """[..., N] bool: who interacts; of `observed [..., N, T, 2]` metres, `valid [..., N]`."""
    before, last = (
        np.linalg.norm(
            observed[..., :, None, at, :] - observed[..., None, :, at, :], axis=-1
        )
        for at in (-2, -1)
    )
    others = (
        valid[..., :, None] & valid[..., None, :] & ~np.eye(valid.shape[-1], dtype=bool)
    )
    return (others & (last < NEAR) & (before - last > NEARER)).any(axis=-1)


@jax.jit
def _happening(scenes: Scene) -> jax.Array:
    """[E, B, N] bool: who takes part in each group's events, of scenes `[B, N, ...]`."""

    def participants(scene: Scene) -> jax.Array:
        path = jnp.concatenate([scene.observed[:, -1:], scene.known_future], axis=1)
        others = (
            scene.valid[:, None] & scene.valid & ~jnp.eye(len(scene.valid), dtype=bool)
        )
        names = tuple(itertools.chain(*EVENTS.values()))
        first = event_steps(SymbolSettings(), names, path[:, None], path)
        happens = dict(zip(names, (first < path.shape[1] - 1) & others))
        pairs = [
            functools.reduce(jnp.logical_or, map(happens.get, events))
            for events in EVENTS.values()
        ]
        return jnp.stack([pair.any(axis=0) | pair.any(axis=1) for pair in pairs])

    return jax.vmap(participants, out_axes=1)(scenes)


def groups_of(scenes: Scene) -> dict[str, np.ndarray]:
    """[B, N] bool for each group, of padded scenes `[B, N, ...]` with their true futures."""
    valid = np.asarray(scenes.valid)
    happening = np.asarray(
        _happening(scenes.replace(origin=None, identity=None, extras={}))
    )
    return {
        "interacting": interacting(np.asarray(scenes.observed), valid),
        "all": valid,
        **dict(zip(EVENTS, happening)),
    }


def score(
    network: Any, params: Any, windows: Windows, *, samples: int = 20, seed: int = 0
) -> dict[str, tuple[float, float]]:
    """(Mean, people counted) of each metric, such as `interacting joint_ade`, on `windows`.

    `neighbour_near` is the share of people with somebody within 2 m whose forecast they
    change.

    Args:
        network: its configuration.
        params: its parameters.
        windows: the test set.
        samples: k.
        seed: of the noise.
    """
    forecaster, batches = forecaster_of(network), make_batches(windows)
    params = jax.device_put(params)
    sums: dict[str, np.ndarray] = defaultdict(lambda: np.zeros(2))
    for batch in batches:
        noise = batch_noise(forecaster, batch.scene, samples, seed)
        futures, likely = forecast_batch(forecaster, params, batch.scene, noise)
        places = unpacked(futures, np.asarray(batch.scene.valid))
        for group, who in groups_of(batch.scene).items():
            counted = batch.scene.replace(valid=who & (batch.index >= 0)[:, None])
            totals = score_scenes(
                chosen(METRICS[group]), places, counted, probability=likely
            )
            for name, (total, count) in totals.items():
                sums[f"{group} {name}"] += total.sum(), count.sum()
    scores = {
        name: (float(total / count), float(count))
        for name, (total, count) in sums.items()
    }
    if forecaster.sees_neighbours:
        effect = score_forecaster(
            forecaster,
            params,
            batches,
            # One sample of anchors is one of k heads: of people who stand it stands as
            # well.
            samples=1 if forecaster.noise.dim else samples,
            seed=seed,
            metrics=("neighbour_near",),
        ).scores["neighbour_near"]
        scores["neighbour_near"] = (float(effect.mean), float(effect.count.sum()))
    return scores
