"""Whatever fails on the disk: every file is the old or the new one, whole, and work goes on."""

import builtins
import errno
import io
import itertools
import json
import os
import shutil
from pathlib import Path

import pytest

from neurosym_jax.errors import InputError
from neurosym_jax.evaluation.compare import write_report
from neurosym_jax.models.disk import load_model, save_model
from neurosym_jax.models.sgan.network import GeneratorConfig
from neurosym_jax.runtime.files import write_json
from tests.networks import random_model

NETWORK = GeneratorConfig(
    obs_len=2, pred_len=1, pooling="none", embedding_dim=2, mlp_dim=2
)


class Disk:
    """Operation number `at` of those that change the disk fails; half of a write is done."""

    def __init__(self, patch, at):
        self.at, self.count = at, 0
        for name in ("fsync", "mkdir", "rename", "replace"):
            patch.setattr(os, name, self.striking(getattr(os, name)))
        plain = io.open

        def opening(file, mode="r", *arguments, **options):
            changes = set(mode) & set("wax+") and not str(file).startswith("/dev/")
            opened = (self.striking(plain) if changes else plain)(
                file, mode, *arguments, **options
            )
            if changes:
                write = opened.write
                opened.write = self.striking(
                    write, lambda data: write(data[: len(data) // 2])
                )
            return opened

        for module in (io, builtins):
            patch.setattr(module, "open", opening)

    def striking(self, operation, before=lambda data: None):
        def strike_first(*arguments, **options):
            self.count += 1
            if self.count == self.at:
                before(arguments[0])
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
            return operation(*arguments, **options)

        return strike_first


def every_fault(work, check):
    """Let each operation of `work()` fail in turn, in one line, and call `check(done)` after it."""
    for at in itertools.count(1):
        error = None
        with pytest.MonkeyPatch.context() as patch:
            disk = Disk(patch, at)
            try:
                work()
            except (InputError, OSError) as caught:
                error = caught
        assert "\n" not in str(error)
        assert not isinstance(error, OSError) or error.errno == errno.ENOSPC
        check(error is None)
        if disk.count < at:
            assert error is None
            assert at > 5, "no faults were made"
            return


def test_a_report_is_the_old_or_the_new_one(tmp_path, capsys):
    path, (old, new) = (
        tmp_path / "rows.json",
        ([{"model": number}] * 100 for number in (1, 2)),
    )

    def check(done):
        rows = json.loads(path.read_text())["rows"]
        assert rows == new if done else rows in (old, new)
        assert list(tmp_path.iterdir()) == [path]
        write_report(path, old, {})

    write_report(path, old, {})
    every_fault(lambda: write_report(path, new, {}), check)


def test_a_model_is_there_whole_or_not_at_all(tmp_path):
    model, folder = random_model(NETWORK), tmp_path / "model"

    def check(done):
        assert {entry.name for entry in tmp_path.iterdir()} <= {"model"}
        if done or folder.exists():
            assert load_model(folder).config == NETWORK
            shutil.rmtree(folder)

    every_fault(lambda: save_model(folder, model), check)


@pytest.mark.skipif(not Path("/proc/self/fd").exists(), reason="no /proc here")
@pytest.mark.parametrize("kind", ["file", "folder"])
def test_what_is_renamed_is_on_the_disk_before_and_its_folder_after(
    tmp_path, monkeypatch, kind
):
    """Else a power cut leaves a name without its content."""
    events = []
    sync, replace = os.fsync, os.replace

    def fsync(handle):
        events.append(("sync", os.readlink(f"/proc/self/fd/{handle}")))
        sync(handle)

    def replaced(source, target):
        events.append(("replace", str(target)))
        inside = Path(source).rglob("*") if Path(source).is_dir() else ()
        needed = [str(source), *map(str, inside)]
        synced = [path for event, path in events if event == "sync"]
        assert set(needed) <= set(synced)
        replace(source, target)

    monkeypatch.setattr(os, "fsync", fsync)
    monkeypatch.setattr(os, "replace", replaced)
    target = tmp_path / "target"
    if kind == "file":
        write_json(target, [1])
    else:
        save_model(target, random_model(NETWORK))
    assert events[-2:] == [("replace", str(target)), ("sync", str(tmp_path))]
