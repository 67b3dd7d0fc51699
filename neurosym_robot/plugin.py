"""What `neurosym_jax` loads of this package by its entry point: the format of bags.

rosbags is imported when a bag is read.
"""

import dataclasses
from pathlib import Path

from neurosym_jax.data.tables import Format, ReadOptions, register_format
from neurosym_jax.data.tracks import Tracks
from neurosym_robot.ros.definitions import is_bag


@register_format("bag")
@dataclasses.dataclass(frozen=True)
class Bag(Format):
    """Bags of ROS 1 and ROS 2, known by their names."""

    title = "a bag of ROS 1 or ROS 2 with messages of people"
    uses = frozenset()
    topic: str | None = None
    """Topic of the people; default: the only one there is."""
    fixed_frame: str = ""
    """Frame into which coordinates are transformed by /tf; default: that of the messages."""

    def owns(self, path: Path) -> bool:
        """Also a folder with the files of a bag."""
        return is_bag(path)

    def read(self, path: Path, options: ReadOptions, period: float) -> list[Tracks]:
        """The people of `topic`, see `read_bag`."""
        from neurosym_robot.ros.bags import read_bag

        return read_bag(path, self.topic, self.fixed_frame)
