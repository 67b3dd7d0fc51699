"""What `neurosym_jax` loads of this package by its entry point: the reader of bags.

rosbags is imported when a bag is read, ROS 2 by the command that needs it.
"""

from pathlib import Path

from neurosym_jax.data.formats import Format, register_format
from neurosym_jax.data.reading import ReadOptions
from neurosym_jax.data.tracks import Tracks
from neurosym_robot.ros.bag_names import is_bag

__all__: list[str] = []


def _read(path: Path, options: ReadOptions, period: float) -> list[Tracks]:
    from neurosym_robot.ros.bag_format import read_bag

    return read_bag(path, options, period)


register_format(
    "bag",
    Format(
        text="a bag of ROS 1 or ROS 2 with messages of people",
        knows=lambda head: False,
        owns=is_bag,
        read=_read,
        uses=frozenset({"topic"}),
    ),
)
