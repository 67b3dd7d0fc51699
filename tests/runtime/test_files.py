import contextlib
import json
import os
import stat

import pytest

from neurosym_jax.errors import InputError
from neurosym_jax.runtime.files import new_folder, refuse_unwritable, write_json, write_text


def test_a_file_is_replaced_whole(tmp_path):
    path = tmp_path / "new/folder/rows.json"
    write_json(path, {"a": [1, 2.5]})
    assert json.loads(path.read_text()) == {"a": [1, 2.5]}
    write_text(path, "other")
    with pytest.raises(ValueError, match="JSON"):
        write_json(path, {"ade": float("nan")})
    assert path.read_text() == "other"
    assert [each.name for each in path.parent.iterdir()] == ["rows.json"]
    umask = os.umask(0)
    os.umask(umask)
    assert stat.S_IMODE(path.stat().st_mode) == 0o666 & ~umask


def test_what_cannot_be_written_is_refused_before(tmp_path):
    (tmp_path / "file").write_text("")
    for path in (tmp_path, tmp_path / "file/rows.json", tmp_path / ("x" * 300)):
        for refuse in (refuse_unwritable, lambda path: write_text(path, "text")):
            with pytest.raises(InputError, match="cannot be written"):
                refuse(path)
    refuse_unwritable(tmp_path / "new/rows.json")
    assert [each.name for each in tmp_path.iterdir()] == ["file"]


def test_a_folder_is_there_whole_or_not_at_all(tmp_path):
    """After an error of the caller; `test_faults` has those of the disk."""
    with contextlib.suppress(RuntimeError), new_folder(tmp_path / "made") as beside:
        (beside / "within").mkdir()
        (beside / "within/file").write_text("text")
        raise RuntimeError
    assert not list(tmp_path.iterdir())
    (tmp_path / "made").mkdir()
    with pytest.raises(InputError, match="already there"):
        new_folder(tmp_path / "made")
