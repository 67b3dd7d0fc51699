"""What a metric of k sampled forecasts of one scene against the truth is."""

import dataclasses
from collections.abc import Callable
from typing import Any

__all__ = ["Compute", "Metric"]

Compute = Callable[[Any, Any, Any], tuple[Any, Any]]


@dataclasses.dataclass(frozen=True)
class Metric:
    """What forecasts of a test set are scored by: a number, or one for each step."""

    name: str
    """In JSON and in Python."""
    title: str
    """For people; in a table its last word stands below the others."""
    unit: str
    """`m`, ...; `share` for a part of 1, shown in per cent; empty for a plain number."""
    compute: Compute
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
    by_default: bool = True
    """Whether it is computed and shown without being asked for by name (`--metrics`)."""
    noise_free: bool = False
    """Whether `forecast` is the one without noise, [1, N, T, 2], instead of the k samples."""
    on_host: bool = False
    """Whether `compute` is given numpy arrays of B scenes, `[k, B, N, T, 2]`, `[B, N, T, 2]` and
    `[B, N]`, and returns totals and counts `[B]`: for work that depends on the numbers."""

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
