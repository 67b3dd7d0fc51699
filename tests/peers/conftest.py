"""Public code of peers that is run beside ours: where it lies, and how it is imported.

`PEERS=FOLDER pytest tests/peers` runs these tests, which need checkouts of the peers in
FOLDER. Without PEERS they are not collected: a test that never runs is none.
"""

import os
import sys
import types
from pathlib import Path

import pytest

if "PEERS" not in os.environ:
    collect_ignore_glob = ["test_*.py"]

UNUSED = ("pykalman", "pysparkling", "joblib", "prettytable", "cv2", "glob2")
"""What peers import and the functions that we call do not use."""


def unused(name: str) -> type:
    """What a module of `UNUSED` has by any name, but those that Python asks of modules."""
    if name.startswith("__"):
        raise AttributeError(name)
    return object


@pytest.fixture
def peer(monkeypatch):
    """Return a function that puts checkouts on the path.

    They lie by their repositories' names in the folder that PEERS names.
    """
    folder = Path(os.environ["PEERS"]).absolute()

    def use(*names: str) -> Path:
        for name in names:
            assert (folder / name).is_dir(), (
                f"PEERS: {folder} has no checkout of {name}"
            )
            monkeypatch.syspath_prepend(str(folder / name))
        for name in UNUSED:
            if name not in sys.modules:
                module = types.ModuleType(name)
                module.__getattr__ = unused  # pyright: ignore[reportAttributeAccessIssue]
                monkeypatch.setitem(sys.modules, name, module)
        return folder

    return use
