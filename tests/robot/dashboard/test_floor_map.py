"""Maps as ROS saves them."""

import base64
import io

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from neurosym_jax.errors import InputError
from neurosym_robot.dashboard.moments import UNKNOWN, read_floor_map

YAML = "image: room.pgm\nresolution: 0.05\norigin: [-1.0, 2.5, 0.1]\n"
PIXELS = np.array([[0, 205, 254], [254, 100, 0]], np.uint8)


def opacity(told) -> np.ndarray:
    from PIL import Image

    data = base64.b64decode(told["image"].removeprefix("data:image/png;base64,"))
    return np.asarray(Image.open(io.BytesIO(data)))[..., 1]


@pytest.fixture
def room(tmp_path):
    pgm = b"P5\n# CREATOR: map_saver\n3 2\n255\n" + PIXELS.tobytes()
    (tmp_path / "room.pgm").write_bytes(pgm)
    (tmp_path / "room.yaml").write_text(YAML)
    return tmp_path / "room.yaml"


def test_walls_floor_and_the_unknown(room):
    told = read_floor_map(room)
    assert (told["width"], told["height"]) == (0.15, 0.1)
    assert told["origin"] == [-1.0, 2.5, 0.1]
    # As map_server reads it, 205 is (255 - 205) / 255 = 0.196 and so just not free.
    assert_array_equal(opacity(told), [[255, UNKNOWN, 0], [0, UNKNOWN, 255]])
    room.write_text(YAML + "negate: 1\noccupied_thresh: 0.9\nfree_thresh: 0.1\n")
    assert_array_equal(opacity(read_floor_map(room)), [[0, UNKNOWN, 255], [255, UNKNOWN, 0]])


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("", "not a map"),
        ("image: [", "not a map"),
        ("- a", "not a map"),
        (YAML.replace("0.05", "0"), "positive"),
        (YAML.replace("0.05", "wide"), "not a map"),
        (YAML.replace(", 0.1]", "]"), "not a map"),
        (YAML.replace("room.pgm", "none.pgm"), "none.pgm"),
        (YAML.replace("room.pgm", "room.yaml"), "cannot identify image"),
        (YAML.replace("room.pgm", "short.pgm"), "not a map"),
    ],
)
def test_what_is_wrong_is_one_line(room, text, reason):
    room.write_text(text)
    (room.parent / "short.pgm").write_bytes(b"P5\n3 2\n255\n\0\0")
    with pytest.raises(InputError, match=reason) as error:
        read_floor_map(room)
    assert "\n" not in str(error.value)
