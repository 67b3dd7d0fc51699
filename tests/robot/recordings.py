"""Simulated people as a tracker would send them, and bags of them."""

from collections.abc import Iterable
from pathlib import Path
from typing import Any

from neurosym_jax.simulation.scenarios import simulate
from neurosym_robot.ros.bags import BagWriter
from neurosym_robot.ros.messages import make_people
from neurosym_robot.tracking.following import Frame, frames_of_tracks


def walkers(seconds: float, people: int = 3, **options: Any) -> list[Frame]:
    """Frames of people who cross each other's paths, ten a second, stamped from 1.7e9 s on."""
    tracks = simulate("cross-path", 1, seconds, people=people, **options)
    return [
        frame._replace(stamp=frame.stamp + 1.7e9) for frame in frames_of_tracks(tracks)
    ]


def write_people(path: Path, frames: Iterable[Frame], topic: str = "/people") -> Path:
    """Write a bag of people in the frame "odom"; return the path of what was written."""
    with BagWriter(path) as bag:
        for frame in frames:
            bag.write(topic, frame.stamp, make_people(bag.new, frame, "odom"))
    return bag.path
