"""Forecasts on a robot: tracking, forecasting frame by frame, ROS, and a live view.

A plugin of `neurosym_jax`, which does not know it (docs/architecture.md).
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
