"""The table of metrics, with the built-in ones; how they are computed is in `scoring`."""

from collections.abc import Sequence
from typing import Any

from neurosym_jax.errors import InputError
from neurosym_jax.evaluation import best_of_k, collision, distribution, single
from neurosym_jax.evaluation.metric import Compute, Metric
from neurosym_jax.registry import Registry

__all__ = [
    "METRICS",
    "Metric",
    "known_metric",
    "metric_names",
    "register_metric",
]

METRICS: Registry[Metric] = Registry(
    "metric",
    {
        metric.name: metric
        for metric in (
            *best_of_k.METRICS,
            *collision.METRICS,
            *distribution.METRICS,
            *single.METRICS,
        )
    },
)


def register_metric(metric: Metric, *, replace: bool = False) -> None:
    """Have `metric` computed wherever metrics are: tables, JSON, cards, sweeps, replay.

    Raises:
        InputError: for a name that is none, or that another metric has, unless `replace`.
    """
    METRICS.register(metric.name, metric, replace=replace)


def metric_names(further: Sequence[str] = (), *, costly: bool = True) -> tuple[str, ...]:
    """Of the metrics that are computed by default, in the order in which they were registered.

    Args:
        further: names to add; `all` adds every one.
        costly: whether those are among the former whose work is not linear in people.

    Raises:
        InputError: for a name that nobody registered.
    """
    wanted = set(METRICS) if "all" in further else {METRICS[name].name for name in further}
    return tuple(
        name
        for name, metric in METRICS.items()
        if name in wanted or (metric.by_default and (costly or not metric.costly))
    )


def known_metric(name: str) -> Metric:
    """The metric of this name; one that nobody registered here, of a report, has its name alone."""
    return METRICS[name] if name in METRICS else Metric(name, name, "", _not_here(name))


def _not_here(name: str) -> Compute:
    def compute(forecast: Any, future: Any, valid: Any) -> tuple[Any, Any]:
        raise InputError(f"metric {name}: only its name is known here (--plugin brings it)")

    return compute
