"""Files of `torch.save`, read without torch.

Both forms are read: today's zip archive and the legacy stream of pickles (2018, the published SGAN
checkpoints). A pickle is a program, so it is scanned for opcodes that a checkpoint has no use for,
and then run by an unpickler that knows the handful of names a state dict needs and refuses every
other by name: a file can fail to load, but it can run no code. Nor can it ask for much more memory
than its own size: no opcode or name copies what is there already, programs are short, and storages
are read once it is known that the file has them.

It is not a loader of models: what the tensors mean is for `interop.checkpoint` to say.
"""

import io
import os
import pickle
import pickletools
import struct
import zipfile
from typing import Any, BinaryIO

import numpy as np

from neurosym_jax.errors import InputError
from neurosym_jax.interop.stand_ins import KNOWN_GLOBALS, STORAGE_DTYPES, Namespace, Storage
from neurosym_jax.runtime.memory import refuse_beyond_memory

__all__ = ["read_torch_file"]

LEGACY_MAGIC = 0x1950A86A20F9469CFC6C
LEGACY_PROTOCOL = 1001
LARGEST_PROGRAM = 2**24
"""Bytes of a pickle; those of the published checkpoints have some thousands."""
OPCODE_LIMIT = 300_000
"""Of one pickle; each may make an object of some hundred bytes."""
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

    def persistent_load(self, pid: Any) -> Storage:
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
        return Storage(self.found, key, first, length)


def read_torch_file(path: str | os.PathLike) -> Any:
    """What `torch.save` wrote to `path`: plain Python values with a `StoredTensor` for a tensor.

    Raises:
        InputError: naming `path`, when it cannot be read, is cut short or damaged, is not a
            file of torch's, asks for a class that is not a state dict's or for more memory than
            there is.
    """
    try:
        with open(path, "rb") as file:
            head, size = file.read(64), os.fstat(file.fileno()).st_size
            # Someone may name a film or a bag of many gigabytes.
            legacy = LEGACY_MAGIC.to_bytes(10, "little") in head
            if not legacy and not head.startswith(b"PK\x03\x04"):
                what = "not a file of torch.save" if head else "an empty file"
                raise InputError(f"{what}; a .pt checkpoint was expected")
            refuse_beyond_memory("reading it", 4.0 * size, "free some")
            return (_read_legacy if legacy else _read_zip)(file, size)
    except OSError as error:
        raise InputError(f"{path}: {error.strerror or error}") from None
    except InputError as error:
        raise InputError(f"{path}: {error}") from None
    except Exception as error:
        # A damaged pickle or archive fails in whichever way the damage dictates: any type at all.
        reason = " ".join(str(error).split())[:200] or type(error).__name__
        raise InputError(f"{path}: damaged or cut short ({reason})") from None


def _read_legacy(file: BinaryIO, size: int) -> Any:
    file.seek(0)
    stream = io.BytesIO(file.read(LARGEST_PROGRAM))
    magic, protocol, system = (_Unpickler(_next_pickle(stream)).load() for _ in range(3))
    if magic != LEGACY_MAGIC or protocol != LEGACY_PROTOCOL:
        raise InputError(f"legacy torch format {protocol!r:.20} is not {LEGACY_PROTOCOL}")
    if system.get("little_endian") is not True:
        raise InputError("written on a big-endian machine, which is not supported")
    unpickler = _Unpickler(_next_pickle(stream))
    contents = unpickler.load()
    keys = _Unpickler(_next_pickle(stream)).load()
    end = stream.tell()
    file.seek(end)
    for key in keys:
        if key not in unpickler.declared:
            raise InputError(f"holds a storage {key!r:.40} that no tensor uses")
        dtype, numel = unpickler.declared[key]
        end += 8 + numel * dtype.itemsize
        if end > size:
            raise InputError(f"cut short: {end - size} bytes of storage {key!r} are missing")
    if end != size:
        raise InputError(f"{size - end} bytes follow the last storage")
    for key in keys:
        dtype, numel = unpickler.declared[key]
        (written,) = struct.unpack("<q", file.read(8))
        if written != numel:
            raise InputError(f"storage {key!r} has {written} elements where {numel} are declared")
        unpickler.found[key] = np.frombuffer(file.read(numel * dtype.itemsize), dtype)
    return _complete(contents, unpickler)


def _read_zip(file: BinaryIO, size: int) -> Any:
    with zipfile.ZipFile(file) as archive:
        entries = {info.filename: info for info in archive.infolist()}
        roots = [name[: -len("data.pkl")] for name in entries if name.endswith("/data.pkl")]
        if len(roots) != 1:
            raise InputError("a zip archive, but not one of torch.save: it has no data.pkl")
        if any(info.compress_type != zipfile.ZIP_STORED for info in entries.values()):
            raise InputError("a compressed archive, which torch.save never writes")
        if sum(info.file_size for info in archive.infolist()) > size:
            raise InputError("damaged: its parts overlap, for they are larger than the file")
        order, program = f"{roots[0]}byteorder", f"{roots[0]}data.pkl"
        if order in entries and archive.read(order) != b"little":
            raise InputError("written on a big-endian machine, which is not supported")
        if entries[program].file_size > LARGEST_PROGRAM:
            raise InputError(f"its pickle is larger than {LARGEST_PROGRAM} bytes")
        unpickler = _Unpickler(_next_pickle(io.BytesIO(archive.read(program))))
        contents = unpickler.load()
        for key, (dtype, numel) in unpickler.declared.items():
            name = f"{roots[0]}data/{key}"
            if name not in entries:
                raise InputError(f"storage {key!r} is missing")
            if (there := entries[name].file_size) != numel * dtype.itemsize:
                raise InputError(f"storage {key!r} has {there} bytes, not {numel * dtype.itemsize}")
            unpickler.found[key] = np.frombuffer(archive.read(name), dtype)
    return _complete(contents, unpickler)


def _complete(contents: Any, unpickler: _Unpickler) -> Any:
    if missing := sorted(unpickler.declared.keys() - unpickler.found.keys()):
        raise InputError(f"{len(missing)} storages are missing, the first {missing[0]!r}")
    if not isinstance(contents, dict):
        return contents
    spaces = {k: v.attributes for k, v in contents.items() if isinstance(v, Namespace)}
    return {**contents, **spaces}


def _next_pickle(stream: io.BytesIO) -> bytes:
    """The bytes of the pickle that starts here, once its opcodes are found harmless."""
    start = stream.tell()
    for count, (opcode, argument, _) in enumerate(pickletools.genops(stream)):
        if opcode.name not in OPCODES:
            raise InputError(f"refused: the pickle opcode {opcode.name} has no use in a checkpoint")
        if count == OPCODE_LIMIT:
            raise InputError(f"refused: a pickle of more than {OPCODE_LIMIT} opcodes")
        # The unpickler allocates as many memo slots as the index says; picklers count from 0 up.
        if opcode.name == "LONG_BINPUT" and (argument or 0) > count:
            raise InputError("damaged: a memo index is larger than the pickle")
    return stream.getvalue()[start : stream.tell()]
