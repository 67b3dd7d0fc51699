import jax
import numpy as np
import pytest


@pytest.fixture(autouse=True)
def strict():
    """Symbols are made of broadcasts and of square roots at zero: neither may slip."""
    with jax.numpy_rank_promotion("raise"), jax.debug_nans(True):
        yield


@pytest.fixture
def double():
    with jax.enable_x64(True):
        yield


@pytest.fixture(scope="session")
def real_windows(shared):
    """(positions padded to one size, valid, arrays of the released code) of 24 real windows."""
    arrays = np.load(shared / "golden" / "qtc" / "neurosym_golden.npz")
    names = [name[:-3] for name in arrays if name.endswith("_xy")]
    slots = max(len(arrays[f"{name}_xy"]) for name in names)
    windows = []
    for name in names:
        xy = arrays[f"{name}_xy"]
        positions = np.zeros((slots, *xy.shape[1:]))
        positions[: len(xy)] = xy
        kinds = ("legacy_qtc", "signed_qtc", "alpha_shipped")
        expected = {kind: arrays[f"{name}_{kind}"] for kind in kinds}
        windows.append((positions, np.arange(slots) < len(xy), expected))
    return windows
