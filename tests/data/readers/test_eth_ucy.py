import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from neurosym_jax.data import read_any
from neurosym_jax.data.readers.eth_ucy import SCENES, split_files
from neurosym_jax.errors import InputError

# (frame, ped, x, y) with ids, coordinates and order as untidy as they come.
ROWS = [(0, 7, 1.5, -2.0), (0, 3, 0.25, 4.0), (1, 3, 0.5, 4.125), (1, 7, 1.75, -2.0), (2, 3, 1, 4)]


def written(path, template="{} {} {} {}", scale=1, end="\n", before="", after=""):
    lines = [template.format(scale * frame, *rest) for frame, *rest in ROWS]
    path.write_bytes((before + end.join(lines) + end + after).encode())
    return path


@pytest.mark.parametrize(
    ("template", "around"),
    [
        ("{} {} {} {}", {"scale": 6}),
        ("{}\t{}\t{}\t{}\t", {"end": "\r\n"}),
        ("{}, {}, {}, {}", {"before": "\ufeff# frame ped x y\n\n"}),
        ("{};{};{};{}", {"after": "\n\n   \n# the end"}),
        ("  {}   {}  {} {}  ", {"scale": 10}),
        ("{}.0\t{}.0\t{}\t{}", {"scale": 10}),
        ("{:.8e} {:.8e} {:.8e} {:.8e}", {"scale": 10}),
    ],
)
def test_dialects(tmp_path, template, around):
    (tracks,) = read_any(written(tmp_path / "mine.txt", template, **around))
    assert tracks.recording == "mine"
    assert_array_equal(tracks.id, [3, 3, 3, 7, 7])
    assert_allclose(tracks.stamp, [0, 0.4, 0.8, 0, 0.4], atol=1e-12)
    assert_array_equal(tracks.position, [[0.25, 4], [0.5, 4.125], [1, 4], [1.5, -2], [1.75, -2]])


def test_coordinates_are_rounded_as_sgan_does_and_frames_begin_anywhere(tmp_path):
    path = tmp_path / "a.txt"
    path.write_text("0 1 1.23456789 499999.99996\n")
    assert_array_equal(read_any(path)[0].position, [[1.2346, 500000.0]])
    path.write_text("\n".join(f"{780 + 10 * n} 1 {n} 0" for n in (0, 1, 2, 5)))
    assert_allclose(np.diff(read_any(path)[0].stamp), [0.4, 0.4, 1.2])


def test_splits_leave_one_out(tmp_path):
    names = [name for scene in SCENES.values() for name in scene]
    for part, ending in {"all": "", "train": "_train", "val": "_val"}.items():
        (tmp_path / part).mkdir()
        for name in [*names, *(["crowds_zara03", "uni_examples"] if ending else [])]:
            (tmp_path / part / f"{name}{ending}.txt").touch()
    for scene, own in SCENES.items():
        assert [path.stem for path in split_files(tmp_path, scene, "test")] == list(own)
        for split in ("train", "val"):
            names = {path.stem for path in split_files(tmp_path, scene, split)}
            assert len(names) == 8 - len(own)
            assert not names & {f"{name}_{split}" for name in own}
        assert len(split_files(tmp_path, None, "train")) == 8
    (tmp_path / "all/biwi_eth.txt").unlink()
    for folder, scene, split, message in (
        (tmp_path, "zara9", "test", "unknown scene 'zara9'"),
        (tmp_path, "eth", "test", r"biwi_eth\.txt: missing, and scene eth needs it"),
        (tmp_path / "absent", None, "val", r"absent/val/\*\.txt: missing"),
    ):
        with pytest.raises(InputError, match=message):
            split_files(folder, scene, split)
