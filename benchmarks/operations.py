"""Numpy's elementwise operations, counted: what a function does on the host, whatever else runs."""

from collections.abc import Callable
from typing import Any

import numpy as np

__all__ = ["operations"]


class _Counted(np.ndarray):
    """Counts the elements that ufuncs, `take` and indexing by arrays go through."""

    count = 0

    def __array_ufunc__(
        self, ufunc: Any, method: str, *inputs: Any, out: Any = (), **options: Any
    ):
        plain = [
            np.asarray(value) if isinstance(value, _Counted) else value
            for value in inputs
        ]
        if out:
            options["out"] = tuple(np.asarray(value) for value in out)
        result = getattr(ufunc, method)(*plain, **options)
        _Counted.count += max(map(np.size, [*plain, result]))
        return out[0] if out else result.view(_Counted) if np.ndim(result) else result

    def take(self, *arguments: Any, **options: Any):
        return self._moved(super().take(*arguments, **options))

    def __getitem__(self, at: Any):
        item = super().__getitem__(at)
        indices = at if isinstance(at, tuple) else (at,)
        copied = any(isinstance(value, np.ndarray) for value in indices)
        return self._moved(item) if copied else item

    @staticmethod
    def _moved(result: Any) -> Any:
        _Counted.count += np.size(result)
        return result


def operations(function: Callable[..., object], array: np.ndarray, *others: Any) -> int:
    """Elements gone through by `function(array, *more)` in what it computes from `array`."""
    before = _Counted.count
    function(array.view(_Counted), *others)
    return _Counted.count - before
