"""Metrics of k sampled forecasts of one scene against what happened, and the registry of them.

Joint best-of-k takes one sample for the whole scene (SGAN's protocol); marginal best-of-k lets each
agent have its own, which is what most later papers report. The two are not comparable, so both are
always computed. The minima of ADE and of FDE are taken independently, as SGAN does.

How metrics are computed over many scenes is not said here (see `scoring`).
"""

import dataclasses
from collections.abc import Callable

import jax
import jax.numpy as jnp
from jax import Array

from neurosym_jax.errors import InputError
from neurosym_jax.registry import Registry

__all__ = [
    "COLLISION_DISTANCE",
    "METRICS",
    "Metric",
    "collisions",
    "known_metric",
    "metric_names",
    "register_metric",
]

COLLISION_DISTANCE = 0.2
"""Metres between two people's centres under which they collide."""


@dataclasses.dataclass(frozen=True)
class Metric:
    """What forecasts of a test set are scored by: a number, or one for each step."""

    name: str
    """In JSON and in Python."""
    title: str
    """For people; in a table its last word stands below the others."""
    unit: str
    """`m`, ...; `share` for a part of 1, shown in per cent; empty for a plain number."""
    compute: Callable[[Array, Array, Array], tuple[Array, Array]]
    """`(forecast [k, N, T, 2], future [N, T, 2], valid [N]) -> (total, count)` of one scene.

    A function that `jax.vmap` and `jax.jit` can take; positions are metres relative to the scene's
    origin, and those of agents that are not valid mean nothing. `total` is the sum of the values of
    the scene's agents, [] or, step by step, [T]; `count []` is how many they are. For one value a
    scene the count is 1. The mean over a test set is the sum of totals over the sum of counts.
    """
    about: str = ""
    """A line below a table that says what it is; metrics that say the same share it."""
    higher_is_better: bool = False
    costly: bool = False
    """Whether its work is not linear in people; `--no-collisions` leaves such metrics out."""

    @property
    def label(self) -> str:
        """Title and unit."""
        return f"{self.title} [{self.unit}]" if self.unit else self.title

    def text(self, value: float | None) -> str:
        """`value` as a table has it, without the unit where that is metres."""
        if value is None:
            return "-"
        if self.unit == "share":
            return f"{100 * value:.1f} %"
        return f"{value:.3f}" + (f" {self.unit}" if self.unit not in ("", "m") else "")


METRICS: Registry[Metric] = Registry("metric")


def register_metric(metric: Metric, *, replace: bool = False) -> None:
    """Have `metric` computed wherever metrics are: tables, JSON, cards, sweeps, replay.

    Raises:
        InputError: for a name that is none, or that another metric has, unless `replace`.
    """
    METRICS.register(metric.name, metric, replace=replace)


def metric_names(*, costly: bool = True) -> tuple[str, ...]:
    """Of all metrics, in the order in which they were registered, or of all but the costly ones."""
    return tuple(name for name, metric in METRICS.items() if costly or not metric.costly)


def known_metric(name: str) -> Metric:
    """The metric of this name; one that nobody registered here, of a report, has its name alone."""
    return METRICS[name] if name in METRICS else Metric(name, name, "", _not_here(name))


def _not_here(name: str) -> Callable[[Array, Array, Array], tuple[Array, Array]]:
    def compute(forecast: Array, future: Array, valid: Array) -> tuple[Array, Array]:
        raise InputError(f"metric {name}: only its name is known here (--plugin brings it)")

    return compute


def collisions(forecast: Array, valid: Array) -> Array:
    """Which agents come closer than `COLLISION_DISTANCE` to another in the same sample.

    Between time steps everybody moves in a straight line, so that fast crossings count.

    Args:
        forecast: [k, N, T, 2] metres.
        valid: [N] bool.

    Returns:
        [k, N] bool.
    """
    pairs = valid[:, None] & valid[None, :] & ~jnp.eye(len(valid), dtype=bool)

    def one_sample(forecast: Array) -> Array:
        # Step by step and each coordinate by itself: everything is elementwise in [N, N], which
        # becomes one loop, many times as fast as arrays of [N, N, T, 2].
        xs, ys = (
            [of_step[:, None] - of_step[None, :] for of_step in jnp.unstack(coordinate, axis=1)]
            for coordinate in jnp.unstack(forecast, axis=-1)
        )
        least = xs[-1] ** 2 + ys[-1] ** 2
        for x, y, to_x, to_y in zip(xs, ys, xs[1:], ys[1:]):
            # The offset moves along a segment; its nearest point to zero is at `t` in [0, 1].
            dx, dy = to_x - x, to_y - y
            # The least number there is, for an offset that stays.
            length = jax.lax.max(dx**2 + dy**2, tiny)
            t = jax.lax.clamp(zero, -(x * dx + y * dy) / length, one)
            least = jax.lax.min(least, (x + t * dx) ** 2 + (y + t * dy) ** 2)
        return ((least < COLLISION_DISTANCE**2) & pairs).any(axis=-1)

    zero, one, tiny = (
        jnp.asarray(number, forecast.dtype) for number in (0, 1, jnp.finfo(forecast.dtype).tiny)
    )
    # Sample by sample, so that memory follows N^2 and not k N^2.
    return jax.lax.map(one_sample, forecast)


@jax.jit  # So that several metrics trace it once.
def _distance(forecast: Array, future: Array, valid: Array) -> Array:
    """[k, N, T] metres, zero for agents that are not valid."""
    offset = jnp.square(forecast - future)
    return jnp.where(valid[:, None], jnp.sqrt(offset[..., 0] + offset[..., 1]), 0)


def _joint_ade(forecast: Array, future: Array, valid: Array) -> tuple[Array, Array]:
    distance = _distance(forecast, future, valid)
    return distance.mean(axis=-1).sum(axis=-1).min(), valid.sum()


def _joint_fde(forecast: Array, future: Array, valid: Array) -> tuple[Array, Array]:
    return _distance(forecast, future, valid)[..., -1].sum(axis=-1).min(), valid.sum()


def _marginal_ade(forecast: Array, future: Array, valid: Array) -> tuple[Array, Array]:
    distance = _distance(forecast, future, valid)
    return distance.mean(axis=-1).min(axis=0).sum(), valid.sum()


def _marginal_fde(forecast: Array, future: Array, valid: Array) -> tuple[Array, Array]:
    return _distance(forecast, future, valid)[..., -1].min(axis=0).sum(), valid.sum()


def _collision_rate(forecast: Array, future: Array, valid: Array) -> tuple[Array, Array]:
    return collisions(forecast, valid).sum() / len(forecast), valid.sum()


def _horizon(forecast: Array, future: Array, valid: Array) -> tuple[Array, Array]:
    """The error at each step, in the sample of best joint ADE."""
    distance = _distance(forecast, future, valid)
    best = distance.mean(axis=-1).sum(axis=-1).argmin()
    return distance[best].sum(axis=0), valid.sum()


_JOINT = "joint: the best of k forecasts of the whole scene (SGAN's protocol)"
_MARGINAL = "marginal: each agent's own best of k (most later papers)"

for _metric in (
    Metric("joint_ade", "joint ADE", "m", _joint_ade, _JOINT),
    Metric("joint_fde", "joint FDE", "m", _joint_fde, _JOINT),
    Metric("marginal_ade", "marginal ADE", "m", _marginal_ade, _MARGINAL),
    Metric("marginal_fde", "marginal FDE", "m", _marginal_fde, _MARGINAL),
    Metric("collision_rate", "people in collision", "share", _collision_rate, costly=True),
    Metric("horizon", "mean displacement error", "m", _horizon),
):
    register_metric(_metric)
