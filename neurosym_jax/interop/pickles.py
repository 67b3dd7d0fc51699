"""Files of `torch.save`, read without torch.

Both forms are read: today's zip archive and the legacy stream of pickles (2018, the published SGAN
checkpoints). A pickle is a program, so it is scanned for opcodes that a checkpoint has no use for,
and then run by an unpickler that knows the handful of names a state dict needs and refuses every
other by name: a file can fail to load, but it can run no code.

It is not a loader of models (what the tensors mean is `interop.torch`'s) and writes nothing (see
`interop.pickle_writer`).
"""

import io
import os
import pickle
import pickletools
import struct
import zipfile
from typing import Any

import numpy as np

from neurosym_jax.errors import InputError

__all__ = ["StoredTensor", "read_torch_file"]

LEGACY_MAGIC = 0x1950A86A20F9469CFC6C
LEGACY_PROTOCOL = 1001
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
# No EXT*, INST or OBJ: they reach classes past `find_class`. No protocol 0: torch never wrote it.
# fmt: off
OPCODES = frozenset((
    "PROTO", "FRAME", "STOP", "MARK", "NONE", "NEWTRUE", "NEWFALSE", "BININT", "BININT1", "BININT2",
    "LONG1", "LONG4", "BINFLOAT", "BINUNICODE", "SHORT_BINUNICODE", "EMPTY_TUPLE", "TUPLE",
    "TUPLE1", "TUPLE2", "TUPLE3", "EMPTY_LIST", "APPEND", "APPENDS", "EMPTY_DICT", "SETITEM",
    "SETITEMS", "GLOBAL", "STACK_GLOBAL", "REDUCE", "BUILD", "NEWOBJ", "BINPERSID", "BINPUT",
    "LONG_BINPUT", "BINGET", "LONG_BINGET", "MEMOIZE",
))
# fmt: on


class StoredTensor:
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
            not isinstance(storage, _Storage)
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

    def __setstate__(self, state):
        raise InputError("a tensor carries a state, which torch's never does")


class _Storage:
    """`numel` elements, from `first` on, of the values that the reader finds under `key`."""

    __slots__ = ("_found", "first", "key", "numel")

    def __init__(self, found: dict[str, np.ndarray], key: str, first: int, numel: int):
        self._found, self.key, self.first, self.numel = found, key, first, numel

    def values(self) -> np.ndarray:
        return self._found[self.key][self.first : self.first + self.numel]

    def __setstate__(self, state):
        raise InputError("a storage carries a state, which torch's never does")


class _Dict(dict):
    """Stands for OrderedDict; the module versions torch hangs on it say nothing we need."""

    def __setstate__(self, state):
        pass


class _DefaultDict(_Dict):
    """Stands for the defaultdict(list) in which SGAN's training keeps its losses."""

    def __init__(self, factory=None):
        super().__init__()


class _Namespace(_Dict):
    """Stands for argparse.Namespace: its attributes as entries."""

    def __setstate__(self, state):
        self.update(state)


class _Parameter:
    """Stands for the rebuilding of a Parameter, which is its tensor."""

    def __new__(cls, data, *_requires_grad_and_hooks):
        return data

    def __setstate__(self, state):
        raise InputError("a parameter carries a state, which torch's never does")


# A name stands for itself where it is only ever passed on, never called.
KNOWN_GLOBALS: dict[str, Any] = {
    "collections.OrderedDict": _Dict,
    "collections.defaultdict": _DefaultDict,
    "argparse.Namespace": _Namespace,
    "builtins.list": "list",
    "__builtin__.list": "list",
    "torch.Size": tuple,
    "torch._utils._rebuild_tensor": StoredTensor,
    "torch._utils._rebuild_tensor_v2": StoredTensor,
    "torch._utils._rebuild_parameter": _Parameter,
    **{f"torch.{name}": name for name in STORAGE_DTYPES},
}


class _Unpickler(pickle.Unpickler):
    """Knows `KNOWN_GLOBALS` and storages; `declared` gathers {key: (dtype, numel)}."""

    def __init__(self, data: bytes):
        super().__init__(io.BytesIO(data))
        self.declared: dict[str, tuple[np.dtype, int]] = {}
        self.found: dict[str, np.ndarray] = {}

    def find_class(self, module: str, name: str) -> Any:
        full = f"{module}.{name}"
        if full not in KNOWN_GLOBALS:
            raise InputError(f"refused: it asks for {full[:120]!r}, which no state dict needs")
        return KNOWN_GLOBALS[full]

    def persistent_load(self, pid: Any) -> _Storage:
        tag, kind, key, _location, numel = pid[:5]
        view = pid[5] if len(pid) > 5 else None
        if tag != "storage" or kind not in STORAGE_DTYPES or type(key) is not str:
            raise InputError("it refers to something other than a tensor's storage")
        if type(numel) is not int or not 0 <= numel < 2**48:
            raise InputError(f"storage {key!r} has no sensible size")
        declared = (np.dtype(STORAGE_DTYPES[kind]), numel)
        if self.declared.setdefault(key, declared) != declared:
            raise InputError(f"storage {key!r} is described twice, differently")
        _, first, length = view or (None, 0, numel)
        whole = type(first) is int and type(length) is int
        if not whole or not 0 <= first <= first + length <= numel:
            raise InputError(f"a view reaches outside storage {key!r} of {numel}")
        return _Storage(self.found, key, first, length)


def read_torch_file(path: str | os.PathLike) -> Any:
    """What `torch.save` wrote to `path`: plain Python values with a `StoredTensor` for a tensor.

    Raises:
        InputError: naming `path`, when it cannot be read, is cut short or damaged, is not a
            file of torch's, or asks for a class that is not a state dict's.
    """
    try:
        with open(path, "rb") as file:
            head = file.read(64)
            # Refused before it is read whole: someone may name a film or a bag of many gigabytes.
            legacy = LEGACY_MAGIC.to_bytes(10, "little") in head
            if not legacy and not head.startswith(b"PK\x03\x04"):
                what = "not a file of torch.save" if head else "an empty file"
                raise InputError(f"{what}; a .pt checkpoint was expected")
            data = head + file.read()
        return _read_legacy(data) if legacy else _read_zip(data)
    except OSError as error:
        raise InputError(f"{path}: {error.strerror or error}") from None
    except InputError as error:
        raise InputError(f"{path}: {error}") from None
    except Exception as error:
        # A damaged pickle or archive fails in whichever way the damage dictates: any type at all.
        reason = " ".join(str(error).split())[:200] or type(error).__name__
        raise InputError(f"{path}: damaged or cut short ({reason})") from None


def _read_legacy(data: bytes) -> Any:
    stream = io.BytesIO(data)
    magic, protocol, system = (_Unpickler(_next_pickle(stream)).load() for _ in range(3))
    if magic != LEGACY_MAGIC or protocol != LEGACY_PROTOCOL:
        raise InputError(f"legacy torch format {protocol!r:.20} is not {LEGACY_PROTOCOL}")
    if system.get("little_endian") is not True:
        raise InputError("written on a big-endian machine, which is not supported")
    unpickler = _Unpickler(_next_pickle(stream))
    contents = unpickler.load()
    keys = _Unpickler(_next_pickle(stream)).load()
    position = stream.tell()
    for key in keys:
        if key not in unpickler.declared:
            raise InputError(f"holds a storage {key!r:.40} that no tensor uses")
        dtype, numel = unpickler.declared[key]
        end = position + 8 + numel * dtype.itemsize
        if end > len(data):
            raise InputError(f"cut short: {end - len(data)} bytes of storage {key!r} are missing")
        (written,) = struct.unpack_from("<q", data, position)
        if written != numel:
            raise InputError(f"storage {key!r} has {written} elements where {numel} are declared")
        unpickler.found[key] = np.frombuffer(data, dtype, numel, position + 8)
        position = end
    if position != len(data):
        raise InputError(f"{len(data) - position} bytes follow the last storage")
    return _complete(contents, unpickler)


def _read_zip(data: bytes) -> Any:
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        entries = {info.filename: info for info in archive.infolist()}
        roots = [name[: -len("data.pkl")] for name in entries if name.endswith("/data.pkl")]
        if len(roots) != 1:
            raise InputError("a zip archive, but not one of torch.save: it has no data.pkl")
        if any(info.compress_type != zipfile.ZIP_STORED for info in entries.values()):
            raise InputError("a compressed archive, which torch.save never writes")
        order = f"{roots[0]}byteorder"
        if order in entries and archive.read(order) != b"little":
            raise InputError("written on a big-endian machine, which is not supported")
        unpickler = _Unpickler(_next_pickle(io.BytesIO(archive.read(f"{roots[0]}data.pkl"))))
        contents = unpickler.load()
        for key, (dtype, numel) in unpickler.declared.items():
            name = f"{roots[0]}data/{key}"
            if name not in entries:
                raise InputError(f"storage {key!r} is missing")
            values = archive.read(name)
            if len(values) != numel * dtype.itemsize:
                raise InputError(
                    f"storage {key!r} has {len(values)} bytes, not {numel * dtype.itemsize}"
                )
            unpickler.found[key] = np.frombuffer(values, dtype)
    return _complete(contents, unpickler)


def _complete(contents: Any, unpickler: _Unpickler) -> Any:
    if missing := sorted(unpickler.declared.keys() - unpickler.found.keys()):
        raise InputError(f"{len(missing)} storages are missing, the first {missing[0]!r}")
    return contents


def _next_pickle(stream: io.BytesIO) -> bytes:
    """The bytes of the pickle that starts here, once its opcodes are found harmless."""
    start = stream.tell()
    for opcode, argument, position in pickletools.genops(stream):
        if opcode.name not in OPCODES:
            raise InputError(f"refused: the pickle opcode {opcode.name} has no use in a checkpoint")
        # The unpickler allocates as many memo slots as the index says; picklers count from 0 up.
        if opcode.name == "LONG_BINPUT" and (argument or 0) > (position or 0) - start:
            raise InputError("damaged: a memo index is larger than the pickle")
    return bytes(stream.getbuffer()[start : stream.tell()])
