"""Strict numerics for every test, and the folder of real data where there is one."""

import os
from pathlib import Path

import jax
import pytest

jax.config.update("jax_debug_nans", True)


@pytest.fixture(scope="session")
def shared() -> Path:
    """The folder of published checkpoints and golden cases; the test skips where it is absent."""
    beside = Path(__file__).resolve().parents[2] / "shared"
    folder = Path(os.environ.get("NEUROSYM_SHARED", beside))
    if not folder.is_dir():
        pytest.skip(f"no shared data at {folder} (set NEUROSYM_SHARED)")
    return folder
