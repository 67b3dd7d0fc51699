"""What stands for the classes of torch and Python that the pickle of a checkpoint may name.

None of them runs anything, keeps a state of the pickle's own choice, or copies what it is given.
How they are put together is `interop.pickles`'s.
"""

from typing import Any

import numpy as np

from neurosym_jax.errors import InputError

__all__ = ["KNOWN_GLOBALS", "STORAGE_DTYPES", "Namespace", "Storage", "StoredTensor"]

STORAGE_DTYPES = {
    "FloatStorage": "<f4",
    "DoubleStorage": "<f8",
    "HalfStorage": "<f2",
    "LongStorage": "<i8",
    "IntStorage": "<i4",
    "ShortStorage": "<i2",
    "CharStorage": "|i1",
    "ByteStorage": "|u1",
    "BoolStorage": "|b1",
}


class Stateless:
    """What torch never gives a state: a pickle could put anything into it."""

    __slots__ = ()

    def __setstate__(self, state):
        raise InputError("a tensor or a part of it carries a state, which torch's never does")


class StoredTensor(Stateless):
    """A tensor of a file: its `shape` and, through `numpy.asarray`, its values.

    Raises:
        InputError: when it reaches outside its storage.
    """

    __slots__ = ("_offset", "_storage", "_strides", "shape")

    # `__new__`, because a pickle can make an object without calling `__init__`.
    def __new__(cls, storage, offset, shape, strides, *_requires_grad_and_hooks):
        """Check what the file says of the tensor; its values may not have been read yet."""
        counts = (offset, *shape, *strides)
        if (
            not isinstance(storage, Storage)
            or len(shape) != len(strides)
            or len(shape) > 8
            or not all(type(n) is int and 0 <= n < 2**48 for n in counts)
        ):
            raise InputError("a tensor is described in a way torch does not")
        elements = int(np.prod(shape, dtype=object))
        last = offset + sum((n - 1) * step for n, step in zip(shape, strides, strict=True))
        # A tensor larger than its storage repeats values (stride 0): weights never do, and a
        # corrupted shape would ask for any amount of memory.
        if elements > storage.numel or (elements and last >= storage.numel):
            raise InputError(
                f"a tensor of shape {list(shape)} reaches outside its storage of {storage.numel}"
            )
        self = super().__new__(cls)
        self._storage, self._offset = storage, offset
        self.shape, self._strides = tuple(shape), tuple(strides)
        return self

    def __array__(self, dtype=None, copy=None):
        """Copy the values out, so that they outlive the file's buffer."""
        values = self._storage.values()[self._offset :]
        strides = [step * values.itemsize for step in self._strides]
        view = np.lib.stride_tricks.as_strided(values, self.shape, strides, writeable=False)
        return np.array(view, dtype)


class Storage(Stateless):
    """`numel` elements, from `first` on, of the values that the reader finds under `key`."""

    __slots__ = ("_found", "first", "key", "numel")

    def __init__(self, found: dict[str, np.ndarray], key: str, first: int, numel: int):
        self._found, self.key, self.first, self.numel = found, key, first, numel

    def values(self) -> np.ndarray:
        """The elements, once they were read."""
        return self._found[self.key][self.first : self.first + self.numel]


class PlainDict(dict):
    """Stands for OrderedDict; the module versions torch hangs on it say nothing we need.

    It begins empty: a pickle that makes it of another may do so any number of times.
    """

    def __init__(self):
        super().__init__()

    def __setstate__(self, state):
        pass


class DefaultDict(PlainDict):
    """Stands for the defaultdict(list) in which SGAN's training keeps its losses."""

    def __init__(self, factory=None):
        super().__init__()


class Namespace:
    """Stands for argparse.Namespace; `_complete` puts its attributes in its place."""

    __slots__ = ("attributes",)

    def __setstate__(self, state):
        self.attributes = state


class Parameter(Stateless):
    """Stands for the rebuilding of a Parameter, which is its tensor."""

    def __new__(cls, data, *_requires_grad_and_hooks):
        return data


class Size(Stateless):
    """Stands for torch.Size, which is made of a tuple, and is that tuple."""

    def __new__(cls, values):
        if type(values) is not tuple:
            raise InputError("a size is not made of a tuple")
        return values


# A name stands for itself where it is only ever passed on, never called.
KNOWN_GLOBALS: dict[str, Any] = {
    "collections.OrderedDict": PlainDict,
    "collections.defaultdict": DefaultDict,
    "argparse.Namespace": Namespace,
    "builtins.list": "list",
    "__builtin__.list": "list",
    "torch.Size": Size,
    "torch._utils._rebuild_tensor": StoredTensor,
    "torch._utils._rebuild_tensor_v2": StoredTensor,
    "torch._utils._rebuild_parameter": Parameter,
    **{f"torch.{name}": name for name in STORAGE_DTYPES},
}
