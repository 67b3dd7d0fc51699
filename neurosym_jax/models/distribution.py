"""Equally probable futures of single scenes, drawn from a model's distribution."""

from typing import TYPE_CHECKING, Any

import numpy as np
from jax import Array
from jax.typing import ArrayLike

from neurosym_jax.configuration import Count, refuse
from neurosym_jax.data.windows import bucket_of
from neurosym_jax.errors import InputError
from neurosym_jax.models.forecast import Model, SceneForecaster, checked_scene
from neurosym_jax.models.forecaster import Forecaster, key_of, options_of, refuse_many
from neurosym_jax.models.tracking_errors import repair_scene, settle
from neurosym_jax.runtime.programs import program
from neurosym_jax.scene import Scene, pad_scene, to_world

if TYPE_CHECKING:
    from neurosym_jax.models.place.mixture import Remembered
    from neurosym_jax.models.place.place import Place

__all__ = ["draw_futures", "predict_distribution"]


def predict_distribution(
    model: Model,
    observed: ArrayLike,
    *,
    draws: int = 200,
    seed: int = 0,
    recording: str = "",
    frame: int = 0,
    repair: bool = False,
    place: "Place | None" = None,
) -> np.ndarray:
    """Equally probable futures of one scene, for probabilities, regions and risks.

    Those of `anchors` are drawn from what it learned by a proper score. For other
    models they are the samples of `predict`, from as many noises; a model without noise
    has one.

    Args:
        model: see `load_model`.
        observed: [N, obs_len, 2] metres.
        draws: number of futures n.
        seed: with `recording` and `frame`, determines the draws.
        recording: name of the recording.
        frame: index of the first observed step in the recording.
        repair: as in `predict`.
        place: what people did here before, which is watched with the same model; in its
            frame are `observed` and the futures.

    Returns:
        [n, N, pred_len, 2] float64 metres.

    Raises:
        InputError: as `predict`, and for a place of another model.
    """
    refuse(Count, {"draws": draws})
    if place is not None and place.model is not model:
        raise InputError("place: it is watched with another model")
    scene = checked_scene(model, observed, recording, frame, repair)
    forecaster = SceneForecaster(
        model.forecaster, model.params, samples=1, seed=seed, repair=repair
    )
    memory = None
    if place is not None:
        slots = int(bucket_of(len(scene.valid)))
        memory = place.recalled(to_world(scene.observed, scene), scene, slots)
    return draw_futures(forecaster, scene, draws, memory)


def draw_futures(
    forecaster: SceneForecaster,
    scene: Scene,
    count: int,
    memory: "Remembered | None" = None,
) -> np.ndarray:
    """Draw `count` equally probable futures [n, N, pred_len, 2] of `scene`, world metres.

    With the `memory` of a place, `Place.recalled`, some are what people did there before.
    """
    slots = int(bucket_of(len(scene.valid)))
    refuse_many(forecaster.forecaster, count, slots)
    padded = forecaster.forecaster.prepared(pad_scene(scene.bare(), slots))
    futures = _draw(
        forecaster.forecaster,
        forecaster.params,
        padded,
        forecaster.key,
        count,
        forecaster.repair,
        memory,
    )
    return to_world(np.asarray(futures)[:, : len(scene.valid)], scene)


@program((0, 4, 5), compiler_options=options_of)
def _draw(
    forecaster: Forecaster,
    params: Any,
    scene: Scene,
    key: Array,
    count: int,
    repair: bool,
    memory: "Remembered | None",
) -> Array:
    key = key_of(key)
    if not repair or forecaster.repairs:
        return forecaster.distribution(params, scene, key, count, memory)
    period = forecaster.config.period
    scene, repaired = repair_scene(scene, period)
    draws = forecaster.distribution(params, scene, key, count)
    draws = settle(draws, repaired, period)
    if memory is None:
        return draws
    return memory.among(draws, scene, key, count)
