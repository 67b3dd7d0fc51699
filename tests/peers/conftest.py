"""Public code of peers that is run beside ours: where it lies, and how it is imported."""

import os
import sys
import types
from pathlib import Path

import pytest

from tests.repository import ROOT

UNUSED = ("pykalman", "pysparkling", "joblib", "prettytable", "cv2", "glob2")
"""What peers import and the functions that we call do not use."""


def unused(name: str) -> type:
    """What a module of `UNUSED` has by any name, but those that Python asks of modules."""
    if name.startswith("__"):
        raise AttributeError(name)
    return object


@pytest.fixture
def peer(monkeypatch):
    """Return a function that puts checkouts on the path, or skips the test where they are absent.

    They lie by their repositories' names in the folder that PEERS names; default:
    ../shared/peers.
    """
    folder = Path(os.environ.get("PEERS", ROOT.parent / "shared/peers"))

    def use(*names: str) -> Path:
        for name in names:
            if not (folder / name).is_dir():
                pytest.skip(f"{folder / name} is not there (PEERS names the folder)")
            monkeypatch.syspath_prepend(str(folder / name))
        for name in UNUSED:
            if name not in sys.modules:
                module = types.ModuleType(name)
                module.__getattr__ = unused  # pyright: ignore[reportAttributeAccessIssue]
                monkeypatch.setitem(sys.modules, name, module)
        return folder

    return use
