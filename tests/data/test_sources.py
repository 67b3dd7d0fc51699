import pytest
from numpy.testing import assert_array_equal

from neurosym_jax.data.sources import open_source
from neurosym_jax.errors import InputError


def test_each_file_is_a_scene(tmp_path):
    for name in ("b.txt", "a.csv"):
        (tmp_path / name).write_text("0 1 2 3\n1 1 2 3\n")
    source = open_source(tmp_path)
    assert source.scenes == ("a", "b")
    (tracks,) = source.recordings("b")
    assert tracks.recording == "b"
    by_name, by_path = source.files(["a", str(tmp_path / "a.csv")])
    assert_array_equal(by_name.position, by_path.position)
    with pytest.raises(InputError, match="c: no such file, nor a recording among a, b"):
        source.files(["a", "c"])
    with pytest.raises(InputError, match="unknown scene 'eth': there are a, b"):
        source.recordings("eth")


def test_leave_one_recording_out(tmp_path):
    for name, first in (("a", 0), ("b", 100), ("c", 200)):
        rows = [f"{first + n} {who} {first + n / 2} {who}" for n in range(10) for who in (1, 2)]
        (tmp_path / f"{name}.txt").write_text("\n".join(rows))
    (tmp_path / "d.txt").write_text("0 1 2 3\n")  # One point can only be validated on.
    with pytest.raises(InputError, match="a: the only recording, so nothing is left to train"):
        open_source(tmp_path / "a.txt").recordings("a", "train")
    source = open_source(tmp_path)
    found = {
        split: {
            tracks.recording: tracks.position[tracks.id == 1, 0].tolist()
            for tracks in source.recordings("b", split)
        }
        for split in ("train", "val", "test")
    }
    assert found == {
        "train": {"a": [n / 2 for n in range(8)], "c": [200 + n / 2 for n in range(8)]},
        "val": {"a": [4, 4.5], "c": [204, 204.5], "d": [2]},
        "test": {"b": [100 + n / 2 for n in range(10)]},
    }


@pytest.mark.parametrize(
    ("names", "message"),
    [
        ((), r"no \.txt, \.csv.* file in it"),
        (("general.txt",), "called alike, or one general"),
        (("a.txt", "a.csv"), "two files are called alike"),
    ],
)
def test_refused(tmp_path, names, message):
    for name in names:
        (tmp_path / name).write_text("0 1 2 3\n")
    with pytest.raises(InputError, match=message):
        open_source(tmp_path)
    with pytest.raises(InputError, match="no such file or folder"):
        open_source(tmp_path / "absent")
