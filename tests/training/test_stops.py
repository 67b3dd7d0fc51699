"""A training or a sweep that ends at any of its file operations goes on to the same bits.

The folder is copied before each operation that changes it: what a kill leaves at that
moment. Every copy is then resumed, in a release, and every twelfth otherwise. Python
tells of operations by audit events; those of libraries in C++ lie between two of these.
"""

import contextlib
import dataclasses
import hashlib
import json
import os
import re
import shutil
import sys
from pathlib import Path

import numpy as np
import pytest
from orbax.checkpoint import v1 as ocp

from neurosym_jax.commands import sweep
from neurosym_jax.models.anchors.network import AnchorConfig, AnchorTableConfig
from neurosym_jax.models.anchors.training import AnchorRecipe
from neurosym_jax.models.disk import load_model
from neurosym_jax.training.loop import train_run
from tests.repository import exhaustive

CHANGES = {
    "open",
    "os.mkdir",
    "os.rename",
    "os.remove",
    "os.rmdir",
    "os.truncate",
    "shutil.rmtree",
    "ctypes.dlsym/handle",  # renameat2, by which folders are exchanged
    "ctypes.dlsym",
}
pytestmark = pytest.mark.usefixtures("one_class")
TABLE = AnchorTableConfig(4, 3, samples=3)
ANCHORS = AnchorConfig(4, 3, samples=3)


class Watch:
    """Copies of `folder` at its distinct moments, below `copies`, while it is `on`."""

    def __init__(self, folder: Path, copies: Path):
        self.folder, self.copies = folder, copies
        self.digests: set[str] = set()
        self.on = False
        sys.addaudithook(self.hear)

    def hear(self, event: str, arguments: tuple) -> None:
        if not self.on or event not in CHANGES:
            return
        if event == "open" and not self.writes(*arguments):
            return
        self.on = False  # Copying has events of its own.
        self.copy()
        self.on = True

    def writes(self, path, mode, flags) -> bool:
        inside = isinstance(path, str) and path.startswith(str(self.folder))
        return inside and bool(flags & (os.O_WRONLY | os.O_RDWR | os.O_CREAT))

    def copy(self) -> None:
        """Copy the folder, unless it was seen as it is."""
        if not self.folder.exists():
            return
        digest = hashlib.sha256()
        for path in sorted(self.folder.rglob("*")):
            name = re.sub(r"\.[0-9a-f]{8}\b", "", str(path.relative_to(self.folder)))
            digest.update(name.encode())
            with contextlib.suppress(OSError):
                digest.update(str(path.stat().st_size).encode())
        if digest.hexdigest() not in self.digests:
            self.digests.add(digest.hexdigest())
            target = self.copies / f"{len(self.digests):03d}"
            with contextlib.suppress(shutil.Error):  # A file went while it was copied.
                shutil.copytree(self.folder, target)


@contextlib.contextmanager
def stops(folder, copies):
    """What lay in `folder` at each stop of the work in this context, in a list filled at its end."""
    found: list[Path] = []
    watch = Watch(folder, copies)
    watch.on = True
    try:
        yield found
    finally:
        watch.on = False
    found += sorted(copies.iterdir())


def kept(folder):
    """The last state, the parameters of the model, and the log, to the bit.

    No card: it names the commit of a checkout that may go on meanwhile.
    """
    state = ocp.load(str(max((folder / "checkpoints").glob("step_*")) / "state"))
    leaves = {name: array.tobytes() for name, array in state.items()}
    parameters = (folder / "model" / "params.safetensors").read_bytes()
    return leaves, parameters, (folder / "metrics.jsonl").read_bytes()


def half_written(folder):
    return [path.name for path in folder.rglob(".*") if path.name != ".lock"]


@pytest.fixture
def runs(run):
    """A run of each family, of two validations."""
    recipe = AnchorRecipe(
        steps=4, validate_every=2, batch_scenes=4, crowd_share=0.0, ema=0.9
    )
    sgan = dataclasses.replace(
        run.recipe, steps=4, validate_every=2, warmup_steps=1, batch_scenes=4
    )
    symbols = dataclasses.replace(
        run.config, pooling="as_described,hidden_dim=16", weighting="cnd"
    )
    return {
        "anchor_table": dataclasses.replace(run, config=TABLE, recipe=recipe),
        "anchors": dataclasses.replace(run, config=ANCHORS, recipe=recipe),
        "sgan": dataclasses.replace(run, recipe=sgan),
        "neurosym": dataclasses.replace(run, config=symbols, recipe=sgan),
    }


FAMILIES = [
    ("anchor_table", 12),
    exhaustive("anchor_table", 1),
    exhaustive("anchors", 1),
    exhaustive("sgan", 1),
    exhaustive("neurosym", 1),
]


@pytest.mark.parametrize(("family", "every"), FAMILIES)
def test_every_stop_of_a_training_resumes_to_the_same_bits(
    runs, tmp_path, family, every, capsys
):
    run, folder = runs[family], tmp_path / "run"
    with stops(folder, tmp_path / "copies") as copies:
        train_run(run, folder, quiet=True)
    assert len(copies) > 30
    whole = kept(folder)
    for copy in copies[::every]:
        train_run(run, copy, resume=True, quiet=True)
        assert kept(copy) == whole, copy
        assert half_written(copy) == [], copy
        shutil.rmtree(copy)
    assert "damaged" not in capsys.readouterr().err
    print(f"{family}: {len(copies[::every])} of {len(copies)} stops")


TIMED = ("seconds_compiling", "seconds_evaluating", "latency", "forecasts_per_second")


def outcome(folder):
    """What a sweep leaves: rows, errors of each scene, and parameters, without times."""
    rows = json.loads((folder / "sweep.json").read_text())["rows"]
    for row in rows:
        for name in TIMED:
            row.pop(name)
    with np.load(folder / "scenes.npz") as arrays:
        errors = {name: arrays[name].tobytes() for name in arrays}
    models = []
    for model in sorted(folder.glob("*/model")):
        load_model(model)  # Its card fits the digest.
        assert "| check |" in (model / "README.md").read_text()
        models.append((model / "params.safetensors").read_bytes())
    assert (folder / "sweep.md").is_file()
    return rows, errors, models


@pytest.mark.slow
@pytest.mark.parametrize("every", [12, exhaustive(1)])
def test_every_stop_of_a_sweep_resumes_to_the_same_report(
    files, tmp_path, monkeypatch, every, capsys
):
    # Other tests' plugins.
    monkeypatch.setattr("neurosym_jax.commands._options.loaded", list)
    out = tmp_path / "sweep"
    chosen = sweep.Options(
        family=("anchor_table",),
        pooling=(),
        weighting=(),
        seed=(0,),
        set=("batch_scenes=4", "validate_every=2"),
        steps=4,
        obs_len=4,
        pred_len=(4,),
        data=files,
        dataset=("check",),
        out=out,
        jobs=1,
    )
    with stops(out, tmp_path / "copies") as copies:
        assert sweep.run(chosen) == 0
    whole = outcome(out)
    # From the end: the first stops, before anything is trained, are alike.
    for copy in copies[::-every]:
        shutil.rmtree(out)
        copy.rename(out)  # Its recipes have this path.
        assert sweep.run(chosen) == 0
        assert outcome(out) == whole, copy
    print(f"sweep: {len(copies[::-every])} of {len(copies)} stops")
