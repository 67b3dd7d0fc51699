"""Forecast in a ROS 1 graph."""

from neurosym_jax.ros.ros1 import Ros1Options as Options
from neurosym_jax.ros.ros1 import ros1 as run

__all__ = ["Options", "run"]
