"""A driving robot: its people are where they are, whatever /tf does, and who stands never walks."""

import itertools
from pathlib import Path

import numpy as np
import pytest

from neurosym_jax.errors import InputError
from neurosym_robot.input.source import PeopleSource
from neurosym_robot.online.predictor import Predictor, load_models
from neurosym_robot.ros.bags import BagWriter, read_people
from neurosym_robot.ros.definitions import PEOPLE, TF_TOPICS
from neurosym_robot.tracking.following import Frame
from tests.robot.input.robot import SECONDS, TOPIC, Drive

pytest.importorskip("rosbags", reason="rosbags is not installed")

NEAR = 0.02  # metres
DRIVES = [
    *(Drive(late) for late in (0.0, 0.05, 0.1, 0.2, 0.4)),
    Drive(0.1, jitter=0.1),
    Drive(0.2, jitter=0.2),
    Drive(0.05, jitter=0.05, reordered=True),
    Drive(0.1, jitter=0.1, reordered=True),
    *(
        Drive(late, back=back)
        for late, back in itertools.product((0.0, 0.2, 0.4), (0.3, 3.0, 8.0))
    ),
    Drive(0.0, back=0.07),
]


def stream(drive: Drive, source: PeopleSource) -> list[Frame]:
    """The frames of a node that hears the drive."""
    frames = []
    for at, topic, message in drive.messages():
        if topic == TOPIC:
            frames += source.take(PEOPLE, message, received=at)
        else:
            source.transforms.hear(message, topic == TF_TOPICS[1], at)
            frames += source.release(at)
    return frames


def worst(drive: Drive, frames: list[Frame]) -> float:
    """Greatest distance in metres of a person from the truth."""
    off = [frame.xy - drive.truth(frame.stamp, frame.ids) for frame in frames]
    return float(np.linalg.norm(np.concatenate(off), axis=1).max())


@pytest.mark.parametrize("drive", DRIVES, ids=str)
def test_people_are_within_2_cm_of_the_truth(drive):
    source = PeopleSource("map", report=lambda text: None)
    frames = stream(drive, source)
    assert worst(drive, frames) < NEAR
    lost = {
        name: count
        for name, count in source.refused.items()
        if name != "clock set back"
    }
    assert len(frames) + sum(lost.values()) >= 10 * SECONDS - 12 - 10 * drive.late
    assert sum(lost.values()) <= 12


@pytest.mark.parametrize("ending", ["bag", "mcap"])
def test_a_bag_of_the_drive_says_the_same(ending, tmp_path):
    drive = Drive(0.2)
    with BagWriter(tmp_path / f"drive.{ending}") as bag:
        for at, topic, message in drive.messages(bag.new):
            bag.write(topic, at, message)
    frames = list(read_people(bag.path, TOPIC, PeopleSource("map", recorded=True)))
    assert len(frames) > 110
    assert worst(drive, frames) < NEAR
    with pytest.raises(
        InputError, match=r"in 'laser', which moves against 'odom'.*--fixed-frame"
    ):
        list(read_people(bag.path, TOPIC))


@pytest.mark.slow
@pytest.mark.parametrize(
    "drive", [Drive(0.0), Drive(0.4), Drive(0.1, back=3.0)], ids=str
)
def test_who_stands_is_never_forecast_to_walk(drive):
    predictor = Predictor(
        load_models([Path("neurosym_zara1_8")]),
        samples=4,
        max_people=8,
        compile="needed",
    )
    source, ends = PeopleSource("map", report=lambda text: None), []
    for frame in stream(drive, source):
        forecast = predictor.push(*frame)
        for id in () if forecast is None else (0, 1, 10, 11):
            for row in np.flatnonzero(forecast.ids == id):
                way = (
                    forecast.models["neurosym_zara1_8"].samples[:, row]
                    - forecast.observed[row, -1]
                )
                ends.append(np.linalg.norm(way[:, -1], axis=-1).max())
    assert len(ends) > 60
    # A model of people who walk wanders a little; 3.2 s of walking are more than two
    # metres.
    assert max(ends) < 0.5
