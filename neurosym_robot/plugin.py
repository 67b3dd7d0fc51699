"""What `neurosym_jax` loads of this package by its entry point: the format of bags.

rosbags is imported when a bag is read.
"""

import dataclasses
import os
from pathlib import Path

from neurosym_jax.data.formats import register_format
from neurosym_jax.data.reading import Format, ReadOptions
from neurosym_jax.data.tracks import Tracks

# Endings of a ROS 1 bag and of the files in the folder of a ROS 2 bag.
SUFFIXES = (".bag", ".mcap", ".db3")


def is_bag(path: Path) -> bool:
    """Whether a path is a bag, by its name or, for a folder, by the names in it."""
    if path.suffix in SUFFIXES or os.path.isfile(path / "metadata.yaml"):
        return True
    # Without metadata, a folder with a file of its name is an unfinished bag of ROS 2.
    return any(os.path.isfile(path / f"{path.name}_0{end}") for end in SUFFIXES)


@register_format("bag")
@dataclasses.dataclass(frozen=True)
class Bag(Format):
    """Bags of ROS 1 and ROS 2, known by their names."""

    title = "a bag of ROS 1 or ROS 2 with messages of people"
    topic: str | None = None
    """Topic of the people; default: the only one there is."""

    def owns(self, path: Path) -> bool:
        """Also a folder with the files of a bag."""
        return is_bag(path)

    def read(self, path: Path, options: ReadOptions, period: float) -> list[Tracks]:
        """The people of `topic`, see `read_bag`."""
        from neurosym_robot.ros.bags import read_bag

        return read_bag(path, self.topic)
