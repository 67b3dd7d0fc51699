import pytest


@pytest.fixture(scope="session")
def torch():
    """torch itself, which the package never imports; the test skips where it is not installed."""
    return pytest.importorskip("torch", reason="torch is not installed")
