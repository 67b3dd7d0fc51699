"""What a kind of forecasters is; `forecasters` has the table."""

import dataclasses
from collections.abc import Callable, Mapping
from typing import Any

from neurosym_jax.configuration import refuse_below
from neurosym_jax.errors import InputError
from neurosym_jax.forecasting.forecaster import Forecaster

Shapes = Callable[[Any], Mapping[str, tuple[int, ...]]]

__all__ = ["ForecasterKind", "Lengths", "Shapes"]


@dataclasses.dataclass(frozen=True)
class Lengths:
    """The configuration of a forecaster that needs nothing else."""

    obs_len: int = 8
    """Observed time steps."""
    pred_len: int = 8
    """Time steps to forecast."""
    period: float = 0.4
    """Seconds between time steps."""

    def __post_init__(self):
        """Refuse numbers out of range."""
        refuse_below(1, {"obs_len": self.obs_len, "pred_len": self.pred_len})
        if not 0 < self.period < float("inf"):
            raise InputError(f"period must be positive, not {self.period}")


@dataclasses.dataclass(frozen=True)
class ForecasterKind:
    """One kind of forecasters."""

    make: Callable[[Any], Forecaster]
    """From a configuration to the forecaster; equal configurations give equal forecasters."""
    config: type
    """Of the configuration: a frozen dataclass with at least the fields of `Lengths`."""
    title: Callable[[Any], str] | str
    """What a model of this kind is called in tables; may depend on its configuration."""
    shapes: Shapes | None
    """Of the parameters, by path; None where nobody says."""

    def title_of(self, config: Any) -> str:
        """The title of a model with this configuration."""
        return self.title if isinstance(self.title, str) else self.title(config)
