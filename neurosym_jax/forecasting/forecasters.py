"""The table of forecasters."""

import dataclasses
from typing import Any

from neurosym_jax.errors import InputError
from neurosym_jax.forecasting.anchors import AnchorsForecaster, AnchorTableForecaster
from neurosym_jax.forecasting.baselines import ConstantVelocity, ConstantVelocitySampled
from neurosym_jax.forecasting.forecaster import Forecaster, Lengths
from neurosym_jax.forecasting.networks import GeneratorForecaster
from neurosym_jax.registry import Registry

__all__ = ["FORECASTERS", "register_forecaster"]

FORECASTERS: Registry[type[Forecaster]] = Registry(
    "forecaster",
    {
        "generator": GeneratorForecaster,
        "anchors": AnchorsForecaster,
        "anchor_table": AnchorTableForecaster,
        "constant_velocity": ConstantVelocity,
        "constant_velocity_sampled": ConstantVelocitySampled,
    },
)


def register_forecaster(
    name: str, forecaster: type[Forecaster] | None = None, *, replace: bool = False
) -> Any:
    """Add a forecaster, which can then be evaluated, saved, loaded, replayed and served.

    Args:
        name: how a model's folder and `--baselines` name it.
        forecaster: the class; without it, return a decorator of the class.
        replace: replace another forecaster of this name.

    Raises:
        InputError: for a name that is taken or not an identifier, and for a `Config` that is not a
            frozen dataclass with the fields of `Lengths`.
    """

    def register(forecaster: type[Forecaster]) -> type[Forecaster]:
        config = forecaster.Config
        frozen = getattr(getattr(config, "__dataclass_params__", None), "frozen", False)
        has = {field.name for field in dataclasses.fields(config)} if frozen else set()
        if missing := {field.name for field in dataclasses.fields(Lengths)} - has:
            raise InputError(
                f"forecaster {name!r}: its Config must be a frozen dataclass with the fields "
                f"{', '.join(sorted(missing))}"
            )
        return FORECASTERS.register(name, forecaster, replace=replace)

    return register if forecaster is None else register(forecaster)
