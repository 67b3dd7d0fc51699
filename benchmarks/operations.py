"""Numpy's elementwise operations, counted: what a function does on the host, whatever else runs."""

from collections.abc import Callable
from typing import Any

import numpy as np

__all__ = ["operations"]


class _Counted(np.ndarray):
    """Counts the elements that ufuncs, `take` and indexing by arrays go through."""

    count = 0

    def __array_ufunc__(self, ufunc: Any, method: str, *inputs: Any, out: Any = (), **more: Any):
        given = [np.asarray(each) if isinstance(each, _Counted) else each for each in inputs]
        if out:
            more["out"] = tuple(np.asarray(each) for each in out)
        result = getattr(ufunc, method)(*given, **more)
        _Counted.count += max(map(np.size, [*given, result]))
        return out[0] if out else result.view(_Counted) if np.ndim(result) else result

    def take(self, *arguments: Any, **more: Any):
        return self._moved(super().take(*arguments, **more))

    def __getitem__(self, at: Any):
        found = super().__getitem__(at)
        indices = at if isinstance(at, tuple) else (at,)
        copied = any(isinstance(each, np.ndarray) for each in indices)
        return self._moved(found) if copied else found

    @staticmethod
    def _moved(found: Any) -> Any:
        _Counted.count += np.size(found)
        return found


def operations(function: Callable[..., object], array: np.ndarray, *more: Any) -> int:
    """Elements gone through by `function(array, *more)` in what it computes from `array`."""
    before = _Counted.count
    function(array.view(_Counted), *more)
    return _Counted.count - before
