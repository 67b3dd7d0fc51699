"""Forecasters with a fixed number of samples that have probabilities: anchors and anchor table."""

import dataclasses
import functools
from collections.abc import Callable, Mapping
from typing import Any, ClassVar

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from neurosym_jax.data.windows import Windows
from neurosym_jax.errors import InputError
from neurosym_jax.models.anchors.config import (
    AnchorConfig,
    AnchorForecast,
    AnchorTableConfig,
)
from neurosym_jax.models.anchors.draws import (
    draw_apart,
    draw_samples,
    draw_scenes,
    equal_points,
)
from neurosym_jax.models.anchors.training import AnchorRecipe, AnchorStream, batch_loss
from neurosym_jax.models.forecaster import Forecaster, checked_key, with_weighting
from neurosym_jax.models.place.mixture import Remembered
from neurosym_jax.models.tracking_errors import repair_tracks
from neurosym_jax.runtime.process import COMPILED_UNFUSED
from neurosym_jax.runtime.programs import full_precision
from neurosym_jax.scene import Scene, with_steps

__all__ = ["AnchorTableForecaster", "AnchorsForecaster", "apply_anchors", "spread_of"]

CROWD = 128
"""Slots above which the pairs of a scene are too many to compute all of them."""
PLACES = 32
"""C is a multiple of it, so that few programs are compiled."""


@dataclasses.dataclass(frozen=True)
class AnchorTableForecaster(Forecaster):
    """An `AnchorTable`: its samples are equally probable."""

    Config: ClassVar[type] = AnchorTableConfig
    recipes: ClassVar[Mapping[str, Any]] = {"anchors": AnchorRecipe()}
    # Its layers are no loop over time.
    compiler_options: ClassVar[Mapping[str, Any]] = COMPILED_UNFUSED

    @property
    def title(self) -> str:
        """What tables call it."""
        return "anchor table"

    @property
    def sees_neighbours(self) -> bool:
        """The table has the same offsets for everybody."""
        return False

    @property
    def shortest(self) -> int:
        """One step: who was seen once may go anywhere."""
        return 1

    @property
    def repairs(self) -> bool:
        """Table and network see plausible tracks, see `repair_tracks`."""
        return True

    def init(self, key: Array) -> Any:
        """See `Forecaster.init`."""
        observed, valid = jnp.zeros((1, self.config.obs_len, 2)), jnp.ones(1, bool)
        params = _network(self.config).init(checked_key(key), observed, valid)
        return with_weighting(params, getattr(self.config, "weighting", None))

    def count(self, samples: int) -> int:
        """See `Forecaster.count`.

        Raises:
            InputError: for more samples than the configuration has.
        """
        if samples > self.config.samples:
            most = self.config.samples
            raise InputError(
                f"samples: {self.title} makes at most {most}, not {samples}"
            )
        return samples

    def forecast(self, params: Any, scene: Scene, noise: Array) -> Array:
        """See `Forecaster.forecast`."""
        return self.representatives(params, scene, noise)[0]

    def representatives(
        self, params: Any, scene: Scene, noise: Array
    ) -> tuple[Array, Array]:
        """The k samples [k, N, pred_len, 2] and their probabilities [k].

        `noise [k, 0]` says how many. `spread_of` chooses them if the network has more,
        and their probabilities are those given that the future is one of them.
        """
        scene = with_steps(scene, self.config.obs_len)
        samples, log_probability, _ = apply_anchors(self.config, params, scene)
        valid, probability = jnp.asarray(scene.valid), jnp.exp(log_probability)
        if len(noise) < len(samples):
            chosen = spread_of(samples, probability, valid, len(noise))
            samples, probability = samples[chosen], probability[chosen]
            probability = probability / probability.sum()
        return samples, probability

    def distribution(
        self,
        params: Any,
        scene: Scene,
        key: Array,
        count: int,
        memory: Remembered | None = None,
        even: bool = True,
    ) -> Array:
        """See `Forecaster.distribution`; possible futures are drawn about equally often.

        Half of the scenes are drawn from points of the mirrored scene: people's left
        and right differ less than what a network has learned of them at a few places.
        Without `even`, draws are independent.
        """
        scene = with_steps(scene, self.config.obs_len)
        for part in scene.identity:
            key = jax.random.fold_in(key, part)
        if not self.calibrated:
            forecast = apply_anchors(self.config, params, scene)
            draws = self._sample_draws(forecast, key, count, even)
            return draws if memory is None else memory.among(draws, scene, key, count)

        order, *parts = jax.random.split(key, 3)
        views = jax.random.permutation(order, jnp.arange(2))

        def drawn(turn: tuple[Array, Array]) -> Array:
            view, part = turn
            points, weight = self._view(params, scene, view), None
            if memory is not None:
                most = len(points)
                points, weight = memory.beside(points, view, 2)
                if even:
                    points, weight = equal_points(points, weight, part, most), None
            number, period = -(-count // 2), self.config.period
            return draw_scenes(points, scene, part, number, period, weight, even)

        draws = jax.lax.map(drawn, (views, jnp.stack(parts)))
        return draws.swapaxes(0, 1).reshape(-1, *draws.shape[2:])[:count]

    def independent_draws(
        self,
        params: Any,
        scene: Scene,
        key: Array,
        count: int,
        memory: Remembered | None = None,
    ) -> Array:
        """See `Forecaster.independent_draws`."""
        return self.distribution(params, scene, key, count, memory, even=False)

    def _sample_draws(
        self, forecast: AnchorForecast, key: Array, count: int, even: bool
    ) -> Array:
        """[n, N, pred_len, 2] of the table's samples, one of their own for each person."""
        return draw_apart(forecast.samples, key, count, even)

    def points(self, params: Any, scene: Scene, key: Array) -> Array:
        """See `Forecaster.points`; those of the scene, and of the mirrored one."""
        scene = with_steps(scene, self.config.obs_len)
        if not self.calibrated:
            return super().points(params, scene, key)
        views = jax.lax.map(functools.partial(self._view, params, scene), jnp.arange(2))
        return views.reshape(-1, *views.shape[2:])

    def _view(self, params: Any, scene: Scene, view: Array | int) -> Array:
        """[P, N, pred_len, 2] points, seen in a mirror for `view` 1."""
        mirror = jnp.array([[1.0, 1.0], [1.0, -1.0]])[view]
        seen = scene.replace(observed=scene.observed * mirror)
        return apply_anchors(self.config, params, seen).points * mirror

    def batches(self, windows: Windows, recipe: Any) -> Callable[[int], Any]:
        """Scenes of one size class, and the crowds that they are merged into."""
        return AnchorStream(windows, recipe).batch

    def groups_of(self, batch: Any) -> tuple[Scene, ...]:
        """The scenes, without the index of their crowds."""
        return batch[:1]

    def loss(
        self, params: Any, batch: Any, key: Array, recipe: Any
    ) -> tuple[Array, Any]:
        """See `batch_loss`; histories are cut where the network learns from short ones."""
        apply = functools.partial(apply_anchors, self.config, params)
        short = isinstance(self.config, AnchorConfig) and self.config.short
        return batch_loss(apply, batch, key, recipe, short)


@dataclasses.dataclass(frozen=True)
class AnchorsForecaster(AnchorTableForecaster):
    """An `AnchorNetwork`."""

    Config: ClassVar[type] = AnchorConfig

    @property
    def title(self) -> str:
        """The name, the weighting, and what the attention sees unless the geometry alone."""
        config, parts = self.config, ["anchors"]
        if not config.geometry:
            parts += ["symbols alone"] if config.symbols else ["no neighbours"]
        elif config.symbols:
            parts += ["symbols"]
        if config.weighting is not None:
            parts += [config.weighting.name]
        return ", ".join(parts)

    def _sample_draws(
        self, forecast: AnchorForecast, key: Array, count: int, even: bool
    ) -> Array:
        """[n, N, pred_len, 2] of the network's samples, drawn by their probabilities."""
        probability = jnp.exp(forecast.log_probability)
        return draw_samples(forecast.samples, probability, key, count, even)

    @property
    def shortest(self) -> int:
        """One step if it learned from incomplete histories, else all."""
        return 1 if self.config.short else self.config.obs_len

    @property
    def calibrated(self) -> bool:
        """Whether the network has points."""
        return self.config.points > 0

    @property
    def sees_neighbours(self) -> bool:
        """Whether the attention has inputs."""
        return self.config.interacts

    def prepared(self, scene: Scene) -> Scene:
        """See `Forecaster.prepared`; a crowd has the neighbours within the radius alone."""
        is_crowd = len(scene.valid) > CROWD
        if not is_crowd or not self.sees_neighbours or self.config.weighting:
            return scene
        full_scene = with_steps(scene, self.config.obs_len)
        near = neighbours(full_scene, self.config.radius, self.config.period)
        return scene.replace(near=near)


def neighbours(scene: Scene, radius: float, period: float) -> np.ndarray:
    """`Scene.near` of the valid agents within `radius` metres; C grows until all have a place.

    Positions are those that the network sees, see `repair_tracks`.
    """
    from scipy.spatial import KDTree  # It takes a third of a second to import.

    valid = np.flatnonzero(scene.valid)
    last = repair_tracks(np.asarray(scene.observed)[valid], period).tracks[:, -1]
    pairs = valid[KDTree(last).query_pairs(radius, output_type="ndarray")]
    pairs = np.concatenate([pairs, pairs[:, ::-1]])
    agent, other = pairs[np.argsort(pairs[:, 0], kind="stable")].T
    count = np.bincount(agent, minlength=len(scene.valid))
    slots = np.arange(len(count))
    places = -(-max(count.max(), 1) // PLACES) * PLACES
    near = np.repeat(slots[:, None], places, axis=1)
    near[agent, np.arange(len(agent)) - (np.cumsum(count) - count)[agent]] = other
    return near


@full_precision
def apply_anchors(
    config: Any, params: Any, scene: Scene, company: Array | float = 0.0
) -> AnchorForecast:
    """All that the network or table of `config` forecasts of one scene.

    Of the scene's `alpha [N, N, obs_len]`, or else the weighting's, the last step
    counts; for `company` see `AnchorNetwork`.
    """
    observed, valid = jnp.asarray(scene.observed), jnp.asarray(scene.valid)
    weighting, alpha = getattr(config, "weighting", None), scene.alpha
    if alpha is None and weighting is not None:
        learned = params.get("weighting", {})
        alpha = weighting.alpha(learned, observed, valid, period=config.period)
    last = None if alpha is None else jnp.asarray(alpha)[..., -1]
    network = {"params": params["params"]}
    seen = None if scene.seen is None else jnp.asarray(scene.seen)
    return _network(config).apply(
        network, observed, valid, last, company, scene.near, seen=seen
    )


def _network(config: Any) -> Any:
    # Imports Flax: only where a network is traced.
    from neurosym_jax.models.anchors.network import AnchorNetwork, AnchorTable

    if isinstance(config, AnchorConfig):
        return AnchorNetwork(config)
    return AnchorTable(config)


@full_precision
def spread_of(samples: Array, probability: Array, valid: Array, count: int) -> Array:
    """[count] indices of the samples that represent all of them best.

    The first of `samples [K, N, T, 2]` is the most probable one. Each further one
    lowers most the expected distance from a sample, drawn with its `probability [K]`,
    to the nearest chosen one; distances are means over people and steps. So the choice
    of `count` begins with the choice of `count` - 1.
    """
    offset = jnp.square(samples[:, None] - samples).sum(-1)
    distance = jnp.where(valid[:, None], jnp.sqrt(offset), 0).sum((-1, -2))
    chosen = [probability.argmax()]
    for _ in range(count - 1):
        nearest = distance[:, jnp.stack(chosen)].min(1)
        expected = probability @ jnp.minimum(nearest[:, None], distance)
        taken = jnp.isin(jnp.arange(len(samples)), jnp.stack(chosen))
        chosen.append(jnp.where(taken, jnp.inf, expected).argmin())
    return jnp.stack(chosen)
