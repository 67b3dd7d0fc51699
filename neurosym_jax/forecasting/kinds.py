"""The kinds of forecasters there are, by name: what a model folder, a table or a robot asks for.

SGAN's generator (NeuroSyM is one with another pooling) and the baselines are registered in
`built_in_forecasters`, in the same way as a forecaster of one's own (`register_forecaster`), which
can then be evaluated, saved, loaded, replayed and served like them. What a forecaster is,
`forecaster` says.
"""

import dataclasses
import importlib
from collections.abc import Callable, Mapping
from typing import Any

from neurosym_jax.checks import refuse_below
from neurosym_jax.errors import InputError
from neurosym_jax.forecasting.forecaster import Forecaster
from neurosym_jax.registry import Registry

Shapes = Callable[[Any], Mapping[str, tuple[int, ...]]]

__all__ = ["FORECASTERS", "ForecasterKind", "Lengths", "register_forecaster"]


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


def register_forecaster(
    name: str,
    make: Callable[[Any], Forecaster],
    *,
    config: type = Lengths,
    title: Callable[[Any], str] | str | None = None,
    shapes: Shapes | None = None,
    replace: bool = False,
) -> None:
    """Add a kind of forecasters.

    Args:
        name: how a model folder and `--baselines` name it.
        make: from a configuration to the forecaster; equal configurations give equal forecasters,
            so that they share compiled programs.
        config: the configuration's type, a frozen dataclass that has at least `obs_len`, `pred_len`
            and `period` as `Lengths` has them, and values that JSON can hold.
        title: what tables call it, or a function of the configuration; the name by default.
        shapes: from a configuration to the shapes of the parameters by path (see `parameters`), by
            which a model's folder is checked; by default it is not.
        replace: put it in the place of another of this name.

    Raises:
        InputError: for what is no name, one that is taken, or a configuration without these fields.
    """
    wanted = {field.name for field in dataclasses.fields(Lengths)}
    has = {field.name for field in dataclasses.fields(config)} if _is_frozen(config) else set()
    if missing := wanted - has:
        raise InputError(
            f"forecaster {name!r}: its configuration must be a frozen dataclass with the fields "
            f"{', '.join(sorted(missing))}"
        )
    kind = ForecasterKind(make, config, name if title is None else title, shapes)
    FORECASTERS.register(name, kind, replace=replace)


def _is_frozen(config: Any) -> bool:
    parameters = getattr(config, "__dataclass_params__", None)
    return isinstance(config, type) and parameters is not None and parameters.frozen


FORECASTERS: Registry[ForecasterKind] = Registry(
    "forecaster", lambda: importlib.import_module("neurosym_jax.forecasting.built_in_forecasters")
)
