"""Pixels to metres and back, and left and right."""

import numpy as np
import pytest

from neurosym_jax.data import ReadOptions, read_any, windows_from
from neurosym_jax.data.columns import outside, project, read_homography
from neurosym_jax.errors import InputError
from neurosym_jax.symbolic import observe
from studies.mistakes.crowd import CROWD, text

H = np.array([[0.02, 0.001, -3.0], [0.002, 0.03, 1.0], [0.0001, 0.0002, 1.0]])


def test_there_and_back(tmp_path):
    pixels = np.random.default_rng(0).uniform(0, 600, (50, 2))
    truth = np.array([(H @ [u, v, 1])[:2] / (H @ [u, v, 1])[2] for u, v in pixels])
    np.testing.assert_allclose(project(H, pixels), truth)
    np.testing.assert_allclose(project(np.linalg.inv(H), truth), pixels, atol=1e-9)
    np.savetxt(tmp_path / "H.txt", H)
    np.testing.assert_allclose(read_homography(tmp_path / "H.txt"), H)
    swapped = read_homography(f"{tmp_path}/H.txt,row-column")
    np.testing.assert_allclose(project(swapped, pixels[:, ::-1]), truth)
    assert outside(H, truth, 600, 600) == 0
    assert outside(H, truth, 600, 300) == pytest.approx(np.mean(pixels[:, 1] > 299.5))
    for content, message in (
        ("1 2 3", "3 x 3"),
        ("1 1 1 1 1 1 1 1 1", "inverse"),
        ("a", "3 x 3"),
    ):
        (tmp_path / "bad.txt").write_text(content)
        with pytest.raises(InputError, match=rf"bad\.txt: .*{message}"):
            read_homography(tmp_path / "bad.txt")


def test_a_recording_is_read_through_a_homography(tmp_path):
    """Positions in pixels, written by the inverse, are the crowd's in metres again."""
    position = np.column_stack([CROWD.x, CROWD.y])
    pixels = project(np.linalg.inv(H), position)
    rows = text(CROWD.but(x=pixels[:, 0].round(6), y=pixels[:, 1].round(6)))
    (tmp_path / "pixels.txt").write_text(rows)
    np.savetxt(tmp_path / "H.txt", H)
    order = np.lexsort((CROWD.step, CROWD.id))
    for flip in (False, True):
        options = ReadOptions(homography=str(tmp_path / "H.txt"), flip_y=flip)
        (tracks,) = read_any(tmp_path / "pixels.txt", options)
        truth = position[order] * [1, -1 if flip else 1]
        np.testing.assert_allclose(tracks.position, truth, atol=1e-4)


def test_a_homography_to_centimetres_is_one_to_centimetres(tmp_path):
    (tmp_path / "a.txt").write_text(text())
    (tracks,) = read_any(tmp_path / "a.txt")
    np.savetxt(tmp_path / "cm.txt", np.diag([100, 100, 1]))
    options = ReadOptions(homography=str(tmp_path / "cm.txt"), unit="cm")
    (turned,) = read_any(tmp_path / "a.txt", options)
    np.testing.assert_allclose(turned.position, tracks.position)


def test_left_is_counter_clockwise_and_a_mirror_image_turns_it(tmp_path):
    """q3 and q4 of a recording change their sign when y is turned, q1 and q2 stay."""
    (tmp_path / "a.txt").write_text(text())
    codes = []
    for flip in (False, True):
        windows = windows_from(tmp_path / "a.txt", 8, 8, read=ReadOptions(flip_y=flip))
        first = windows.position[: windows.bounds[1]]
        codes.append(np.asarray(observe(first[0], first[1])))
    assert codes[0][..., 2:].any()
    np.testing.assert_array_equal(codes[1][..., :2], codes[0][..., :2])
    np.testing.assert_array_equal(codes[1][..., 2:], -codes[0][..., 2:])
