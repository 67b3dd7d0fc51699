"""The names of `models.forecaster`, `forecast`, `distribution` and `disk` under their old
name, for one release.
"""

import importlib
from typing import Any

__all__ = []  # What the rooms export, by `__getattr__`.
ROOMS = ("forecaster", "forecast", "distribution", "disk")


def __getattr__(name: str) -> Any:
    for room in ROOMS:
        module = importlib.import_module(f"neurosym_jax.models.{room}")
        if name in module.__all__:
            return getattr(module, name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
