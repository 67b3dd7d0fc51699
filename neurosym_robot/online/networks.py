"""A model in JAX as a predictor calls it: programs for a few numbers of people."""

import functools
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from neurosym_jax.data.windows import bucket_of
from neurosym_jax.models.forecast import Model, SceneForecaster, draw_futures
from neurosym_jax.models.forecaster import Representatives
from neurosym_jax.models.place.mixture import Remembered
from neurosym_jax.scene import Scene, make_scene, pad_scene, scene_identity
from neurosym_robot.online.window import Observed


class Pending(NamedTuple):
    """A forecast of N people that was begun."""

    scene: Scene
    padded: Scene
    """The scene in the slots of a program."""
    futures: Representatives


class Network:
    """Forecasts scenes with a `Model`."""

    def __init__(self, model: Model, samples: int, seed: int, repair: bool):
        """As `SceneForecaster`."""
        self._forecaster = SceneForecaster(
            model.forecaster, model.params, samples=samples, seed=seed, repair=repair
        )
        self._takes_short = model.forecaster.shortest < model.config.obs_len
        self.samples = self._forecaster.samples
        self.repairs = repair or model.forecaster.repairs

    @staticmethod
    def sizes(most: int) -> set[int]:
        """Numbers of people that have a program, for up to `most`."""
        return {int(bucket_of(people + 1)) for people in range(most)}

    def start(
        self, observed: Observed, recording: str, frame: int, slots: int
    ) -> Pending:
        """Begin the forecast of people whose windows begin at step `frame`.

        A network that learned from incomplete histories is told which steps were seen.
        """
        scene = make_scene(observed.positions, recording=recording, frame=frame)
        if self._takes_short:
            scene = scene.replace(seen=observed.sighted)
        padded = pad_scene(scene, slots)
        return Pending(scene, padded, self._forecaster.start(padded))

    def finish(self, pending: Pending) -> tuple[np.ndarray, np.ndarray | None]:
        """The samples [k, N, pred_len, 2] in metres, and their probabilities [k], if any."""
        return SceneForecaster.finish(pending.futures, pending.scene)

    def drawing(
        self,
        pending: Pending,
        samples: np.ndarray,
        central: int | None,
        recording: str,
        memory: Remembered | None = None,
    ) -> Callable[[], np.ndarray] | None:
        """What draws [k, N, pred_len, 2] metres; None where `samples` are draws.

        The `central` one of equally probable samples stays as it is; it is None where
        samples have probabilities. With the `memory` of a place, people do what others
        did there.
        """
        padded = pending.padded
        if central is None:
            # The same noise in all frames: the draws of a person do not jump.
            padded = padded.replace(identity=scene_identity(recording, 0))
        elif memory is None:
            return None
        return functools.partial(self._draw, padded, samples, central, memory)

    def _draw(
        self, padded: Scene, samples: np.ndarray, central: int | None, memory: Any
    ) -> np.ndarray:
        futures = draw_futures(self._forecaster, padded, self.samples, memory)
        futures = futures[:, : samples.shape[1]]
        if central is not None:
            futures[central] = samples[central]
        return futures
