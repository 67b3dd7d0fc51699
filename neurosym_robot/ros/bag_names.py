"""Which paths are bags, by their names; they are opened in `ros.bags`."""

import os
from pathlib import Path

__all__ = ["ACTIVE", "SUFFIXES", "files_of", "is_bag", "tool_for"]

SUFFIXES = (".bag", ".mcap", ".db3")
"""Of ROS 1's file and of the files in ROS 2's folders."""
ACTIVE = ".bag.active"
"""How the name of a file of ROS 1 ends until it is finished; a folder has no metadata so long."""
UNFINISHED = ("_0.mcap", "_0.db3", ".mcap", ".db3")
"""How the first file in a folder is named after it, by ROS 2 and by rosbags."""
TOOLS = {".bag": "rosbag reindex", ".mcap": "mcap recover", ".db3": "ros2 bag reindex"}


def is_bag(path: Path) -> bool:
    """Whether a path is a bag, by its name or, of a folder, by what lies in it."""
    if path.name.endswith((*SUFFIXES, ACTIVE)) or os.path.isfile(path / "metadata.yaml"):
        return True
    # A folder without it may also be one of several bags.
    return any(os.path.isfile(path / f"{path.name}{end}") for end in UNFINISHED)


def files_of(path: Path) -> list[Path]:
    """The files of a bag that have messages, or would."""
    inside = [path] if path.is_file() else sorted(path.iterdir())
    return [each for each in inside if each.name.endswith((*SUFFIXES, ACTIVE))]


def tool_for(path: Path) -> str:
    """What may mend such a file."""
    return TOOLS.get(path.suffix, TOOLS[".bag"])
