"""The table of forecasters."""

from neurosym_jax.forecasting.anchors import AnchorsForecaster, AnchorTableForecaster
from neurosym_jax.forecasting.baselines import ConstantVelocity, ConstantVelocitySampled
from neurosym_jax.forecasting.forecaster import Forecaster
from neurosym_jax.forecasting.networks import GeneratorForecaster
from neurosym_jax.plugins import Registry

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

register_forecaster = FORECASTERS.register
