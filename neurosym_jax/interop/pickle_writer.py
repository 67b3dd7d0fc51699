"""Files of `torch.save`'s zip form, written without torch.

The pickle inside is assembled from opcodes, because `pickle.dumps` must import the classes it
names. It is not a general pickler: it writes what a checkpoint of weights and arguments needs.
"""

import os
import pickle
import struct
import zipfile
from collections import OrderedDict
from pathlib import Path
from typing import Any

import numpy as np

from neurosym_jax.errors import InputError
from neurosym_jax.runtime.files import new_file

__all__ = ["write_torch_file"]


def write_torch_file(
    path: str | os.PathLike, contents: dict[str, Any], *, overwrite: bool = False
) -> None:
    """Write `contents` in torch's zip form, for `torch.load(path, weights_only=True)`.

    Dictionaries, tuples, strings, numbers, None and arrays (stored as float32) can be written.
    The file appears whole or not at all, and the same contents give the same bytes.

    Raises:
        InputError: when `path` exists and `overwrite` is False, or cannot be written.
    """
    path = Path(path)
    if path.exists() and not overwrite:
        raise InputError(f"{path}: exists already; say overwrite=True to replace it")
    storages: list[bytes] = []
    program = pickle.PROTO + b"\x02" + _encode(contents, storages) + pickle.STOP
    files = {"data.pkl": program, "byteorder": b"little", "version": b"3\n"}
    files |= {f"data/{key}": values for key, values in enumerate(storages)}
    with new_file(path) as beside, zipfile.ZipFile(beside, "w") as archive:
        for name, values in files.items():
            archive.writestr(zipfile.ZipInfo(f"archive/{name}"), values)


def _encode(value: Any, storages: list[bytes]) -> bytes:
    """Pickle opcodes that rebuild `value`; an array's bytes are appended to `storages`."""
    if value is None:
        return pickle.NONE
    if isinstance(value, bool):
        return pickle.NEWTRUE if value else pickle.NEWFALSE
    if isinstance(value, int):
        return pickle.BININT + struct.pack("<i", value)
    if isinstance(value, float):
        return pickle.BINFLOAT + struct.pack(">d", value)
    if isinstance(value, str):
        text = value.encode()
        return pickle.BINUNICODE + struct.pack("<I", len(text)) + text
    if isinstance(value, tuple):
        return pickle.MARK + b"".join(_encode(v, storages) for v in value) + pickle.TUPLE
    if isinstance(value, dict):
        empty = pickle.EMPTY_DICT
        if isinstance(value, OrderedDict):
            empty = _global("collections.OrderedDict") + pickle.EMPTY_TUPLE + pickle.REDUCE
        items = (_encode(part, storages) for item in value.items() for part in item)
        return empty + pickle.MARK + b"".join(items) + pickle.SETITEMS
    if not isinstance(value, np.ndarray):
        raise TypeError(f"a torch checkpoint has no place for a {type(value).__name__}")
    values = np.ascontiguousarray(value, "<f4").reshape(value.shape)
    strides = tuple(step // values.itemsize for step in values.strides)
    key = str(len(storages))
    storages.append(values.tobytes())
    storage = (
        _encode("storage", storages)
        + _global("torch.FloatStorage")
        + b"".join(_encode(part, storages) for part in (key, "cpu", values.size))
    )
    rebuild = (
        (pickle.MARK + storage + pickle.TUPLE + pickle.BINPERSID)
        + b"".join(_encode(part, storages) for part in (0, values.shape, strides, False))
        + _encode(OrderedDict(), storages)
    )
    call = _global("torch._utils._rebuild_tensor_v2") + pickle.MARK + rebuild + pickle.TUPLE
    return call + pickle.REDUCE


def _global(full: str) -> bytes:
    module, _, name = full.rpartition(".")
    return pickle.GLOBAL + f"{module}\n{name}\n".encode()
