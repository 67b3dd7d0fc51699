"""Forecast in a ROS 2 graph."""

from neurosym_jax.ros.ros2 import Ros2Options as Options
from neurosym_jax.ros.ros2 import ros2 as run

__all__ = ["Options", "run"]
