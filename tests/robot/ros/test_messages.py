"""Messages carry what went in, and are those that robots speak."""

import functools
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from neurosym_robot.online.frames import Frame
from neurosym_robot.ros import messages
from neurosym_robot.ros.definitions import HUMANS_TRAJS, PEOPLE, blank, typestore
from neurosym_robot.ros.people import id_of_name, see

pytest.importorskip("rosbags", reason="rosbags is not installed")


@pytest.fixture(params=[1, 2], ids=["ros1", "ros2"], scope="module")
def store(request):
    return typestore(request.param)


def through_bytes(store: Any, message: Any) -> Any:
    """What a receiver of `message` gets."""
    name = message.__msgtype__
    if "seq" in vars(message.header):
        return store.deserialize_ros1(store.serialize_ros1(message, name), name)
    return store.deserialize_cdr(store.serialize_cdr(message, name), name)


def test_the_checksums_are_those_of_the_robot():
    store = typestore(1)
    wanted = {
        PEOPLE: "18722f4b8db20cc2369740732357847b",
        HUMANS_TRAJS: "2c66d20bf906f8b179d4c4d91ac92096",
    }
    for name, checksum in wanted.items():
        assert store.generate_msgdef(name)[1] == checksum


def test_people_there_and_back(store):
    for ids in ([3, -7, 2**52 + 5], []):
        xy = np.random.default_rng(0).normal(size=(len(ids), 2))
        frame = Frame(1700000000.123456, np.array(ids, np.int64), xy)
        back = see(
            PEOPLE,
            through_bytes(store, messages.make_people(functools.partial(blank, store), frame)),
        )
        assert back.stamp == pytest.approx(frame.stamp, abs=1e-6)
        assert_array_equal(back.ids, frame.ids)
        assert_array_equal(back.xy, frame.xy)


def test_names_that_are_no_numbers_have_ids_of_their_own():
    assert id_of_name("12") == 12
    names = ["person_1", "person_2", "1e3", "", "9" * 30, "²"]
    ids = [id_of_name(name) for name in names]
    assert len(set(ids)) == len(names)
    assert all(2**52 <= id < 2**53 for id in ids)
    assert [id_of_name(str(id)) for id in ids] == ids
    assert ids[0] == 4665009609805463
