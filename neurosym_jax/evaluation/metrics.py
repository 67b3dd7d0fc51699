"""What a metric is, and the table of all metrics; `scoring` computes them."""

import dataclasses
import functools
from collections.abc import Callable, Sequence
from typing import Any

from neurosym_jax.evaluation import formulas, symbol_scores
from neurosym_jax.plugins import Registry

__all__ = [
    "METRICS",
    "SYMBOLS",
    "Metric",
    "known_metric",
    "metric_names",
    "register_metric",
]

Compute = Callable[..., Any]


@dataclasses.dataclass(frozen=True)
class Metric:
    """A score of k forecasts of a scene: one number, or one for each step."""

    title: str
    """Column head; its first word stands above the others."""
    compute: Compute
    """`compute(forecast [k, N, T, 2], scene) -> values` for one scene of N slots.

    `values` has a number for each agent, [N]; for each agent and step, [N, T]; or one
    for the scene, []. `jax.jit` and `jax.vmap` trace it. Positions are metres relative
    to the scene's origin, the truth is `scene.future`; values of slots that are not
    `scene.valid` are ignored.

    The mean over a test set counts each valid agent once, and a scene's number as often
    as the scene has valid agents. To count otherwise return `(values, weights)` with
    weights [N] or [], such as 0 where an agent has no value.
    """
    unit: str = "m"
    """`m`, ...; `share` is shown in per cent; empty for a plain number."""
    about: str = ""
    """A line of explanation below tables; metrics with the same line share it."""
    higher_is_better: bool | None = False
    """None where neither is better; no model is marked as the best then."""
    by_default: bool = True
    """Whether it is computed without being named (`metrics`)."""
    moves: bool = False
    """Whether `forecast` is how far each sample moves when an agent's neighbours are there."""
    weighted: bool = False
    """Whether `compute` takes a third argument, the probabilities [k] of the samples; None where
    all are the same. Other metrics take the samples for equally probable."""
    drawn: bool = False
    """Whether the metric is of the distribution: of equally probable draws, in place of samples,
    where the forecaster is calibrated."""
    on_host: bool = False
    """Whether `compute` gets numpy arrays of a batch, [k, B, N, T, 2] and a scene with a leading
    axis B, and returns [B, N] or [B]: for work that depends on the numbers."""

    @property
    def label(self) -> str:
        """Title and unit."""
        return f"{self.title} [{self.unit}]" if self.unit else self.title

    def text(self, value: float | None) -> str:
        """`value` for a table's cell, without the unit where that is metres."""
        if value is None:
            return "-"
        if self.unit == "share":
            return f"{100 * value:.1f} %"
        return f"{value:.3f}" + (f" {self.unit}" if self.unit not in ("", "m") else "")


_JOINT = "joint: the best of k forecasts of the whole scene (SGAN's protocol)"
_MARGINAL = "marginal: each agent's own best of k (most later papers)"
_MISS = (
    "missed: even the best of k samples of an agent ends more than 2 m from the truth"
)
_CENTRAL = "central: the most probable sample of the scene, or else the one nearest to the others"
_PROPER = "energy score, CRPS: proper scores of the distribution; less is better"
_COVERED = "covered: true positions in the region that should hold this share of them"
_NEIGHBOURS = (
    "neighbours: people of scenes of two or more whose forecast moves by over 1 mm when the others "
    "are removed, of all or of those with somebody within 2 m; mean move at the last step"
)
_SYMBOLS = (
    "states, events: log scores of those of ordered pairs within 8 m; less is better"
)

_further = functools.partial(Metric, by_default=False)
_on_host = functools.partial(_further, unit="share", on_host=True)
_weighted = functools.partial(_further, weighted=True)
_distribution = functools.partial(_weighted, drawn=True)
_moves = functools.partial(
    _further, about=_NEIGHBOURS, moves=True, higher_is_better=None
)
_symbols = functools.partial(_further, unit="nats", about=_SYMBOLS, drawn=True)


def _covered(level: float) -> Metric:
    compute = functools.partial(formulas.coverage, level)
    title = f"covered at {100 * level:.0f} %"
    return _distribution(title, compute, "share", _COVERED, higher_is_better=None)


METRICS: Registry[Metric] = Registry(
    "metric",
    {
        "joint_ade": Metric("joint ADE", formulas.joint_ade, "m", _JOINT),
        "joint_fde": Metric("joint FDE", formulas.joint_fde, "m", _JOINT),
        "marginal_ade": Metric("marginal ADE", formulas.marginal_ade, "m", _MARGINAL),
        "marginal_fde": Metric("marginal FDE", formulas.marginal_fde, "m", _MARGINAL),
        "horizon": Metric("mean error", formulas.horizon),
        "collision_rate": Metric(
            "people in collision", formulas.collision_rate, "share", on_host=True
        ),
        "truth_collision_rate": _on_host(
            "truth's collisions", formulas.truth_collision_rate, higher_is_better=None
        ),
        "excess_collisions": _on_host(
            "collisions beyond truth's", formulas.excess_collisions
        ),
        "draw_collisions": _on_host(
            "draws in collision", formulas.collision_rate, drawn=True
        ),
        "miss_rate": _further("missed by 2 m", formulas.missed, "share", _MISS),
        "energy_score": _distribution(
            "energy score", formulas.energy_score, "m", _PROPER
        ),
        "crps": _distribution("CRPS", formulas.crps, "m", _PROPER),
        "coverage_50": _covered(0.5),
        "coverage_90": _covered(0.9),
        "central_ade": _weighted("central ADE", formulas.central_ade, "m", _CENTRAL),
        "central_fde": _weighted("central FDE", formulas.central_fde, "m", _CENTRAL),
        "neighbour_share": _moves(
            "changed by neighbours", formulas.neighbour_share, "share"
        ),
        "neighbour_near": _moves(
            "changed by near neighbours", formulas.neighbour_near, "share"
        ),
        "neighbour_move": _moves("moved by neighbours", formulas.neighbour_move),
        "state_log": _symbols("states log", symbol_scores.state_log),
        "event_log": _symbols("events log", symbol_scores.event_log),
    },
)

SYMBOLS = ("state_log", "event_log")
"""Names of the metrics of symbols, which take longer than all others together."""


def register_metric(
    name: str, title: str, *, replace: bool = False, **fields: Any
) -> Callable[[Compute], Compute]:
    """Return a decorator that adds a function as a metric to tables, JSON, cards and replay.

    Args:
        name: in JSON, in Python and after `--metrics`.
        title: see `Metric`.
        replace: replace another metric of this name.
        **fields: of `Metric`.
    """

    def register(compute: Compute) -> Compute:
        METRICS.register(name, Metric(title, compute, **fields), replace=replace)
        return compute

    return register


def metric_names(
    further: Sequence[str] = (), *, collisions: bool = True
) -> tuple[str, ...]:
    """Names of the metrics that are computed by default, in the table's order.

    Args:
        further: names to add; `all` adds every metric but those of symbols.
        collisions: whether the collision rate is among the defaults.
    """
    names = {name for name in further if name != "all" and METRICS[name]}
    names |= METRICS.keys() - set(SYMBOLS) if "all" in further else set()
    defaults = {name for name, metric in METRICS.items() if metric.by_default}
    names |= defaults if collisions else defaults - {"collision_rate"}
    return tuple(name for name in METRICS if name in names)


def known_metric(name: str) -> Metric:
    """Return the metric of this name; for one that only a report knows, a title alone."""
    return (
        METRICS[name]
        if name in METRICS
        else Metric(name, METRICS.__getitem__, "", higher_is_better=None)
    )
