"""What `neurosym_jax` loads of this package by its entry point: the reader of bags.

rosbags is imported when a bag is read.
"""

import os
from pathlib import Path

from neurosym_jax.data.formats import Format, register_format
from neurosym_jax.data.reading import ReadOptions
from neurosym_jax.data.tracks import Tracks

__all__ = ["is_bag"]

# Endings of a ROS 1 bag and of the files in the folder of a ROS 2 bag.
SUFFIXES = (".bag", ".mcap", ".db3")
ACTIVE = ".bag.active"  # ending of a ROS 1 bag until its recorder has finished it


def is_bag(path: Path) -> bool:
    """Whether a path is a bag, by its name or, for a folder, by the names in it."""
    if path.name.endswith((*SUFFIXES, ACTIVE)) or os.path.isfile(path / "metadata.yaml"):
        return True
    # Without metadata, a folder with a file of its name is an unfinished bag of ROS 2.
    names = [path.name + end for end in ("_0.mcap", "_0.db3", ".mcap", ".db3")]
    return any(os.path.isfile(path / name) for name in names)


def _read(path: Path, options: ReadOptions, period: float) -> list[Tracks]:
    from neurosym_robot.ros.bags import read_bag

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
