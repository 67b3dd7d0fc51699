"""Files of `torch.save`, read without torch.

Both forms are read: today's zip archive and the legacy stream of pickles (2018, the
published SGAN checkpoints). A pickle is a program, so it is run by an unpickler that
knows only the opcodes and the handful of names that a state dict needs, and refuses
every other by name: a file can fail to load, but it can run no code. What stands for a
name runs nothing and keeps no state of the pickle's own choice.
"""

import io
import math
import os
import pickle
import pickletools
import struct
import zipfile
from typing import Any

import numpy as np
from numpy.lib.stride_tricks import as_strided

from neurosym_jax.errors import InputError, brief
from neurosym_jax.runtime.foreign import refuse_twins
from neurosym_jax.runtime.process import refuse_beyond_memory

__all__ = ["read_torch_file"]

LEGACY_MAGIC = 0x1950A86A20F9469CFC6C
LEGACY_PROTOCOL = 1001
STORAGE_DTYPES = {
    "FloatStorage": "<f4",
    "DoubleStorage": "<f8",
    "HalfStorage": "<f2",
    "LongStorage": "<i8",
    "IntStorage": "<i4",
    "ByteStorage": "|u1",
    "BoolStorage": "|b1",
}
OPCODES = (
    "PROTO FRAME STOP MARK NONE NEWTRUE NEWFALSE BININT BININT1 BININT2 LONG1 LONG4 BINFLOAT "
    "BINUNICODE SHORT_BINUNICODE EMPTY_TUPLE TUPLE TUPLE1 TUPLE2 TUPLE3 EMPTY_LIST APPEND APPENDS "
    "EMPTY_DICT SETITEM SETITEMS GLOBAL STACK_GLOBAL REDUCE BUILD NEWOBJ BINPERSID BINPUT "
    "LONG_BINPUT BINGET LONG_BINGET MEMOIZE"
)
"""No EXT*, INST or OBJ: they reach classes past `find_class`. Torch never wrote protocol 0."""


class Tensor(np.ndarray):
    """A tensor of a file, a view of its storage; a storage is one that owns its memory."""

    # `__new__`, because a pickle can make an object without calling `__init__`.
    def __new__(cls, storage, offset, shape, strides, *_requires_grad_and_hooks):
        """Check that the tensor lies in its storage, whose values are read after the pickle."""
        sizes = (offset, *shape, *strides)
        sizes_fit = all(type(size) is int and 0 <= size < 2**48 for size in sizes)
        stored = isinstance(storage, Tensor) and storage.base is None
        if not stored or not sizes_fit or not len(shape) == len(strides) <= 32:
            raise InputError("a tensor is described in a way torch does not")
        elements = math.prod(shape)
        reach = [(size - 1) * step for size, step in zip(shape, strides)]
        last = offset + sum(reach)
        # A tensor larger than its storage repeats values (stride 0): weights never do,
        # and a corrupted shape would ask for any amount of memory.
        if elements > storage.size or (elements and last >= storage.size):
            raise InputError(
                f"a tensor of shape {list(shape)} reaches outside its storage of {storage.size}"
            )
        steps = [step * storage.itemsize for step in strides]
        return as_strided(storage[offset:], shape, steps, subok=True, writeable=False)

    def __setstate__(self, state):
        """Refuse what torch never does: a pickle could put anything here."""
        raise InputError("a tensor carries a state, which torch's never does")


class PlainDict(dict):
    """Stands for an empty OrderedDict, and a defaultdict of lists (in which SGAN keeps losses)."""

    def __init__(self, factory="list"):
        super().__init__()
        if factory != "list":
            raise InputError("a dictionary is made in a way torch does not")

    def __setstate__(self, state):
        """Pass over the versions of modules that torch hangs on a state dict."""


class PlainNamespace(dict):
    """Stands for an argparse.Namespace, whose attributes are its items."""

    def __setstate__(self, state):
        """Take the attributes, which argparse keeps in a dictionary."""
        if type(state) is not dict:
            raise InputError("a namespace is made in a way argparse does not")
        self.update(state)


class ScalarType:
    """Stands for the numpy.dtype of a number."""

    def __init__(self, code, *_):
        if code not in ("f8", "f4", "f2", "i8", "i4", "i2", "i1", "u1", "b1"):
            raise InputError(f"a number of numpy is of {brief(code)}")
        self.code = code

    def __setstate__(self, state):
        """Pass over the order of bytes, if it is that of torch's own numbers."""
        if type(state) is not tuple or len(state) < 2 or state[1] not in ("<", "|"):
            raise InputError("a number of numpy is stored in another order of bytes")


def _number_of_numpy(kind, data):
    """The number that numpy stores as bytes."""
    if type(kind) is not ScalarType or type(data) is not bytes:
        raise InputError("a number is made in a way numpy does not")
    dtype = np.dtype(kind.code).newbyteorder("<")
    if len(data) != dtype.itemsize:
        raise InputError(f"a number of {kind.code} has {len(data)} bytes")
    (number,) = np.frombuffer(data, dtype)
    return number.item()


def _latin_bytes(text, encoding):
    """The bytes that protocol 2 stores as text."""
    if type(text) is not str or encoding != "latin1":
        raise InputError("bytes are stored in a way pickle does not")
    return text.encode("latin1")


# A name stands for itself where it is only ever passed on, never called.
KNOWN_GLOBALS: dict[str, Any] = {
    "collections.OrderedDict": PlainDict,
    "collections.defaultdict": PlainDict,
    "argparse.Namespace": PlainNamespace,
    "numpy.dtype": ScalarType,
    "numpy.core.multiarray.scalar": _number_of_numpy,
    "numpy._core.multiarray.scalar": _number_of_numpy,
    "_codecs.encode": _latin_bytes,
    "builtins.list": "list",
    "__builtin__.list": "list",
    "torch._utils._rebuild_tensor": Tensor,
    "torch._utils._rebuild_tensor_v2": Tensor,
    **{f"torch.{name}": name for name in STORAGE_DTYPES},
}


class _Opcodes(dict[int, Any]):
    """Methods of `OPCODES` by their byte."""

    def __missing__(self, byte: int) -> Any:
        name = byte
        for code in pickletools.opcodes:
            if ord(code.code) == byte:
                name = code.name
        raise InputError(
            f"refused: the pickle opcode {name} has no use in a checkpoint"
        )


class _Unpickler(pickle._Unpickler):
    """Knows `OPCODES` and `KNOWN_GLOBALS`, and gathers the storages that it meets, empty.

    The one in Python: that in C takes any opcode, as much memory as an index of its
    memo says, and as keys tuples of tuples, which share parts and so take minutes to
    hash.
    """

    dispatch = _Opcodes(
        (ord(code.code), pickle._Unpickler.dispatch[ord(code.code)])
        for code in pickletools.opcodes
        if code.name in OPCODES.split()
    )

    def __init__(self, stream: io.BytesIO, storages: dict[str, Tensor]):
        super().__init__(stream)
        self.storages = storages

    def load_setitem(self) -> None:
        _refuse_keys(self.stack[-2:-1])  # pyright: ignore[reportAttributeAccessIssue]
        super().load_setitem()  # pyright: ignore[reportAttributeAccessIssue]

    def load_setitems(self) -> None:
        _refuse_keys(self.stack[::2])  # pyright: ignore[reportAttributeAccessIssue]
        super().load_setitems()  # pyright: ignore[reportAttributeAccessIssue]

    dispatch |= {pickle.SETITEM[0]: load_setitem, pickle.SETITEMS[0]: load_setitems}

    def find_class(self, module: str, name: str) -> Any:
        full = f"{module}.{name}"
        if full not in KNOWN_GLOBALS:
            raise InputError(
                f"refused: it asks for {brief(full)}, which no state dict needs"
            )
        return KNOWN_GLOBALS[full]

    def persistent_load(self, pid: Any) -> Tensor:
        tag, kind, key, _location, numel, *view = pid
        if tag != "storage" or kind not in STORAGE_DTYPES or view not in ([], [None]):
            raise InputError("it refers to something other than a tensor's storage")
        if type(key) is not str or type(numel) is not int or not 0 <= numel < 2**48:
            raise InputError(f"storage {brief(key)} has no sensible size")
        dtype = np.dtype(STORAGE_DTYPES[kind])
        storage = self.storages.setdefault(
            key, np.ndarray.__new__(Tensor, numel, dtype)
        )
        if (storage.dtype, storage.size) != (dtype, numel):
            raise InputError(f"storage {brief(key)} is described twice, differently")
        return storage


def read_torch_file(path: str | os.PathLike) -> Any:
    """What `torch.save` wrote to `path`: plain Python values with an array for a tensor.

    Raises:
        InputError: naming `path`, when it cannot be read, is cut short or damaged, is
            not a file of torch's, asks for a class that is not a state dict's or for
            more memory than there is.
    """
    try:
        with open(path, "rb") as file:
            # Someone may name a film or a bag of many gigabytes.
            head = file.read(64)
            read = _read_zip
            if LEGACY_MAGIC.to_bytes(10, "little") in head:
                read = _read_legacy
            elif not head.startswith(b"PK\x03\x04"):
                kind = "not a file of torch.save" if head else "an empty file"
                raise InputError(f"{kind}; a .pt checkpoint was expected")
            size = os.fstat(file.fileno()).st_size
            refuse_beyond_memory("reading it", 4.0 * size, "free some")
            return read(io.BytesIO(head + file.read()), {})
    except OSError as error:
        raise InputError(f"{path}: {error.strerror or error}") from None
    except InputError as error:
        raise InputError(f"{path}: {error}") from None
    except Exception as error:
        # A damaged pickle or archive fails in whichever way the damage dictates: any
        # type at all.
        reason = " ".join(str(error).split())[:200] or type(error).__name__
        raise InputError(f"{path}: damaged or cut short ({reason})") from None


def _read_legacy(stream: io.BytesIO, storages: dict[str, Tensor]) -> Any:
    magic, protocol, system = (_load(stream, storages) for _ in range(3))
    is_legacy = magic == LEGACY_MAGIC and protocol == LEGACY_PROTOCOL
    if not is_legacy or system["little_endian"] is not True:
        raise InputError(
            f"of another format ({brief(protocol)}), or of a big-endian machine"
        )
    contents = _load(stream, storages)
    keys = _load(stream, storages)
    _refuse_keys(keys)
    missing = storages.keys() - set(keys)
    if missing:
        raise InputError(f"storage {brief(min(missing))} is missing")
    for key in keys:
        (numel,) = struct.unpack("<q", stream.read(8))
        _fill(storages[key], stream.read(numel * storages[key].itemsize))
    after = len(stream.read())
    if after:
        raise InputError(f"{after} bytes follow the last storage")
    return contents


def _read_zip(stream: io.BytesIO, storages: dict[str, Tensor]) -> Any:
    with zipfile.ZipFile(stream) as archive:
        refuse_twins(archive)
        if min(entry.header_offset for entry in archive.infolist()) != 0:
            raise InputError("refused: something stands before its first entry")
        names = [name for name in archive.namelist() if name.endswith("/data.pkl")]
        if len(names) != 1:
            raise InputError(
                "a zip archive, but not one of torch.save: it has no data.pkl"
            )
        entries = archive.infolist()
        if any(entry.compress_type != zipfile.ZIP_STORED for entry in entries):
            raise InputError(
                "its content is compressed, and may be of any size; torch's never is"
            )
        # Entries may lie on top of each other.
        size = sum(entry.file_size for entry in entries)
        if size > stream.getbuffer().nbytes:
            raise InputError("its entries are larger than itself")
        contents = _load(io.BytesIO(archive.read(names[0])), storages)
        for key, storage in storages.items():
            _fill(storage, archive.read(f"{names[0].removesuffix('.pkl')}/{key}"))
    return contents


def _fill(storage: Tensor, data: bytes) -> None:
    if len(data) != storage.nbytes:
        raise InputError(
            f"{len(data)} bytes for a storage of {storage.size} {storage.dtype}"
        )
    storage[:] = np.frombuffer(data, storage.dtype)


def _load(stream: io.BytesIO, storages: dict[str, Tensor]) -> Any:
    """Run the pickle that starts here."""
    return _Unpickler(stream, storages).load()


def _refuse_keys(keys: Any) -> None:
    if any(type(key) not in (str, int) for key in keys):
        raise InputError("a dictionary's key is neither text nor a number")
