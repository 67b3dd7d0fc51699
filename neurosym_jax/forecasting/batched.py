"""Forecasts of many scenes at once: batches, and agents packed without padding.

If a forecaster's decoding looks at no neighbour, the agents of a batch of padded scenes
are decoded as one scene without padding, in parts of one size: no work is spent on
padding, and one compiled program serves scenes of every size. Single scenes are
`model`'s.
"""

from collections.abc import Callable, Iterable, Sequence
from typing import Any

import jax
import numpy as np
from jax.typing import ArrayLike

from neurosym_jax.configuration import Count, Seed, refuse
from neurosym_jax.data.windows import Batch, Windows, make_batches
from neurosym_jax.errors import InputError
from neurosym_jax.forecasting.forecaster import (
    Forecaster,
    TwoStageForecaster,
    refuse_many,
)
from neurosym_jax.forecasting.model import (
    Model,
    refuse_other_length,
    warn_of_tracking_errors,
)
from neurosym_jax.forecasting.noise import draw_noise, key_numbers, key_of
from neurosym_jax.forecasting.tracking_errors import repair_tracks, settle
from neurosym_jax.runtime.programs import program
from neurosym_jax.scene import Scene, checked_positions, scene_identity

__all__ = [
    "batch_noise",
    "draw_batch",
    "forecast_batch",
    "forecast_windows",
    "predict_scenes",
]
__all__ += ["unpacked"]

PART = 128
"""Agents decoded in one call: with 20 samples their states stay in the second-level cache."""


def predict_scenes(
    model: Model,
    observed: Sequence[ArrayLike],
    *,
    samples: int = 20,
    seed: int = 0,
    recording: str = "",
    frames: Sequence[int] | None = None,
    repair: bool = False,
) -> list[np.ndarray]:
    """`predict` for many scenes `[N_i, obs_len, 2]`, scenes of one padded size at once.

    Forecast i equals `predict(model, observed[i], frame=frames[i], ...)` up to float
    rounding; `frames` are 0, 1, 2, ... by default, `repair` is that of `predict`. All forecasts are in memory
    together, 16 pred_len bytes for each sample of a person; pass larger numbers of
    scenes in parts, with the `frames` of each.

    Returns:
        For each scene `[k, N_i, pred_len, 2]` float64 metres in its own frame.

    Raises:
        InputError: naming the scene that `predict` would refuse; for another number of
            frames than scenes.
    """
    refuse(Count, {"samples": samples})
    frames = range(len(observed)) if frames is None else frames
    if len(frames) != len(observed):
        raise InputError(f"{len(frames)} frames are given for {len(observed)} scenes")
    if not len(observed):
        return []
    named = {f"observed[{number}]": scene for number, scene in enumerate(observed)}
    scenes = [checked_positions(name, scene) for name, scene in named.items()]
    for name, scene in zip(named, scenes):
        refuse_other_length(model, scene, name)
    bounds = np.cumsum([0, *map(len, scenes)])
    identity = scene_identity(recording, np.asarray(frames))
    agents = np.arange(bounds[-1])
    tracks, period = np.concatenate(scenes), model.config.period
    repaired = repair_tracks(tracks, period) if repair else None
    if repair or model.forecaster.repairs:
        warn_of_tracking_errors(tracks, period, "observed")
    if repaired is not None:
        tracks = repaired.tracks
    windows = Windows(tracks, agents, bounds, identity, model.config.obs_len)
    futures, _ = forecast_windows(model, windows, make_batches(windows), samples, seed)
    if repaired is not None:
        futures = settle(futures, repaired, period)
    return np.split(futures, bounds[1:-1], axis=1)


def forecast_windows(
    model: Model,
    windows: Windows,
    batches: Sequence[Batch],
    samples: int,
    seed: int,
    run: Callable[..., Iterable[Any]] = map,
) -> tuple[np.ndarray, np.ndarray | None]:
    """Futures of the A agents and probabilities of the S scenes of `windows`.

    `batches` are all windows; `run` is `map` or an executor's, and applies a function
    to batches.

    Returns:
        [k, A, pred_len, 2] float64 world metres and [k, S]; None where all are the
        same.
    """
    forecaster = model.forecaster
    samples = forecaster.count(samples)
    refuse_many(forecaster, samples, windows.agents, min(windows.agents, PART))
    params = jax.device_put(model.params)
    places = np.empty((samples, windows.agents, forecaster.pred_len, 2))
    likely = np.empty((samples, windows.scenes))

    def of_batch(batch: Batch) -> tuple[np.ndarray, np.ndarray | None]:
        noise = batch_noise(forecaster, batch.scene, samples, seed)
        return forecast_batch(forecaster, params, batch.scene, noise)

    probability = None
    for batch, (futures, probability) in zip(batches, run(of_batch, batches)):
        present = batch.index >= 0
        scenes = batch.index[present]
        if probability is not None:
            likely[:, scenes] = probability[:, present]
        origin = np.repeat(
            np.asarray(batch.scene.origin)[present], windows.sizes[scenes], axis=0
        )
        places[:, windows.rows(scenes)] = futures + origin[:, None]
    return places, None if probability is None else likely


def batch_noise(
    forecaster: Forecaster, scenes: Scene, samples: int, seed: int
) -> np.ndarray:
    """Noise of a batch of B scenes, `[k, B, dim]` or `[k, B, N, dim]`."""
    identity = np.asarray(scenes.identity)
    return draw_noise(forecaster.noise, seed, identity, samples, scenes.valid.shape[1])


def forecast_batch(
    forecaster: Forecaster, params: Any, scenes: Scene, noise: np.ndarray
) -> tuple[np.ndarray, np.ndarray | None]:
    """Futures of the A valid agents of a batch of B scenes, and probabilities of the scenes.

    `noise` is `[k, B, dim]` or `[k, B, N, dim]`, see `batch_noise`.

    Returns:
        [k, A, pred_len, 2] metres relative to each scene's origin, and [k, B]; None
        where all are the same.
    """
    valid = np.asarray(scenes.valid)
    if isinstance(forecaster, TwoStageForecaster) and forecaster.decodes_alone:
        return _decoded_agents(forecaster, params, scenes, noise, valid), None
    futures, likely = _forecast(forecaster, params, scenes.bare(), noise)
    return np.asarray(futures)[:, valid], None if likely is None else np.asarray(likely)


def draw_batch(
    forecaster: Forecaster, params: Any, scenes: Scene, seed: int, count: int
) -> np.ndarray:
    """Draws of a batch of B scenes, [n, B, N, pred_len, 2]; see `Forecaster.distribution`."""
    refuse(Seed, {"seed": seed})
    return np.asarray(
        _draws(forecaster, params, scenes.bare(), key_numbers(seed), count)
    )


def _decoded_agents(
    forecaster: TwoStageForecaster,
    params: Any,
    scenes: Scene,
    noise: np.ndarray,
    valid: np.ndarray,
) -> np.ndarray:
    """`[k, A, pred_len, 2]` of the agents, packed as one scene and decoded in parts of `PART`."""
    encoder, bare = forecaster.encoder, scenes.bare()
    context = () if encoder is None else _encode(encoder, params, bare)
    agents = context, bare.replace(identity=None)
    agents = jax.tree.map(lambda leaf: np.asarray(leaf)[valid], agents)
    agent_noise = (
        noise[:, valid]
        if noise.ndim == 4
        else np.repeat(noise, valid.sum(axis=1), axis=1)
    )
    packed, parts = (*agents, agent_noise.swapaxes(0, 1)), []
    for at in range(0, agent_noise.shape[1], PART):
        part = jax.tree.map(lambda leaf, at=at: _filled(leaf[at : at + PART]), packed)
        futures = _decode(forecaster, params, *part[:-1], part[-1].swapaxes(0, 1))
        parts.append(np.asarray(futures)[:, : agent_noise.shape[1] - at])
    return np.concatenate(parts, axis=1)


def _filled(rows: np.ndarray) -> np.ndarray:
    """`rows` with zeros up to `PART` of them along the first axis."""
    return np.pad(rows, [(0, PART - len(rows)), *[(0, 0)] * (rows.ndim - 1)])


def unpacked(futures: np.ndarray, valid: np.ndarray) -> np.ndarray:
    """`futures [k, A, ...]` in their slots `valid [B, N]`: `[k, B, N, ...]`, zero in padding."""
    places = np.zeros((len(futures), *valid.shape, *futures.shape[2:]), futures.dtype)
    places[:, valid] = futures
    return places


@program((0,))
def _forecast(forecaster, params, scenes, noise):
    return jax.vmap(forecaster.representatives, in_axes=(None, 0, 1), out_axes=1)(
        params, scenes, noise
    )


@program((0, 4))
def _draws(forecaster, params, scenes, key, count):
    return jax.vmap(forecaster.distribution, in_axes=(None, 0, None, None), out_axes=1)(
        params, scenes, key_of(key), count
    )


@program((0,))
def _encode(encoder, params, scenes):
    return jax.vmap(encoder.encode, in_axes=(None, 0))(params, scenes)


@program((0,))
def _decode(forecaster, params, context, agents, noise):
    return forecaster.decode(params, context, agents, noise)
