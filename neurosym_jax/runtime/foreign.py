"""The one door for bytes of others: files, and what libraries make of them.

A library that is given a damaged file raises anything at all, takes any memory, or any
time. So every reader of files enters `reading`, which turns whatever is raised into one
line that names the file, and asks one of the functions here for its content: they look
at sizes before they read. `tests/test_door.py` changes bytes of every kind of file.
"""

import contextlib
import io
import math
import os
import zipfile
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from neurosym_jax.configuration import parse_json
from neurosym_jax.errors import InputError, printable
from neurosym_jax.runtime.process import refuse_beyond_memory

__all__ = [
    "read_array",
    "read_arrays",
    "read_bytes",
    "read_json",
    "read_yaml",
    "reading",
    "refuse_dense",
    "refuse_twins",
]

SMALL, SETTINGS = 64_000_000, 1_000_000
"""Bytes of a report or of a list of cases, and of a file of settings: ours have kilobytes."""
UNPACKED, TIMES = 256_000_000, 100
"""Bytes that a packed file may hold, or as many times its own if that is more."""
VALUES, DENSITY = 2_000_000, 50
"""Values that a table in a packed file may have, or for each of its bytes if that is more.

Positions that differ take a byte each at least, however well they are packed; a column
that never changes takes none."""
HEADERS = {
    (1, 0): np.lib.format.read_array_header_1_0,
    (2, 0): np.lib.format.read_array_header_2_0,
}


@contextlib.contextmanager
def reading(path: Path | str, kind: str = "") -> Iterator[None]:
    """Turn whatever is raised in this context into an InputError that names `path`.

    `kind` says what the file should be, such as "a report". An InputError goes on, with
    the name in front unless it begins with it. The error of a library is the cause of
    ours, so that Python shows both.

    Raises:
        InputError: see above.
    """
    name = printable(str(path))
    try:
        yield
    except InputError as error:
        if not str(error).startswith((f"{path}:", f"{name}:")):
            error.args = (f"{name}: {error}",)
        raise
    except OSError as error:
        raise InputError(f"{name}: cannot be read: {_words(error)}") from None
    except Exception as error:
        raise _damaged(name, kind, error) from error
    except BaseException as error:
        # A library in Rust that panics: no Exception, and no wish of the user's either.
        if type(error).__name__ != "PanicException":
            raise
        raise _damaged(name, kind, error) from error


def _damaged(name: str, kind: str, error: BaseException) -> InputError:
    problem = f"cannot be read as {kind}" if kind else "cannot be read"
    return InputError(
        f"{name}: {problem}: damaged, or of another kind ({_words(error)})"
    )


def _words(error: BaseException) -> str:
    """What a library says, as a short line."""
    text = getattr(error, "strerror", None) or str(error)
    line = printable(" ".join(text.split()))[:200]
    kind = type(error).__name__
    if not line or isinstance(error, KeyError | AttributeError | IndexError):
        return f"{kind} {line}".strip()
    return line


def read_bytes(path: Path | str, limit: float = SMALL) -> bytes:
    """The content of a file, which may have `limit` bytes.

    Raises:
        InputError: naming the file: it cannot be read, or is larger.
    """
    with reading(path), open(path, "rb") as file:
        size = os.fstat(file.fileno()).st_size
        # A device has no size and no end.
        content = b"" if size > limit else file.read(int(limit) + 1)
        if max(size, len(content)) > limit:
            raise InputError(
                f"has more than the {limit / 1e6:.0f} MB that such a file may have"
            )
    return content


def read_json(path: Path | str, kind: str = "JSON") -> Any:
    """The value of a file in JSON, without keys that stand twice.

    Raises:
        InputError: naming the file: as `read_bytes`, and for other text.
    """
    with reading(path, kind):
        return parse_json(read_bytes(path, SMALL), printable(str(path)))


def read_yaml(path: Path | str, kind: str = "YAML", loader: Any = None) -> Any:
    """The value of a file in YAML, without aliases, of which a few lines make gigabytes.

    `loader` is one of PyYAML's that makes plain values; default: its safe one.

    Raises:
        InputError: naming the file: as `read_bytes`, and for other text.
    """
    import yaml

    with reading(path, kind):
        text = read_bytes(path, SETTINGS).decode("utf-8")
        if any(isinstance(event, yaml.AliasEvent) for event in yaml.parse(text)):
            raise InputError("has an alias (*name), which may stand for any amount")
        return yaml.load(text, loader or yaml.SafeLoader)


def read_arrays(path: Path | str, kind: str = "arrays of numpy") -> dict[str, Any]:
    """All arrays of an `.npz` by name, read-only; none may hold objects.

    Sizes are compared with the archive's and with what is free before anything is
    unpacked, and a header with the bytes that follow it.

    Raises:
        InputError: naming the file, and the array where one is wrong.
    """
    with reading(path, kind), open(path, "rb") as file:
        size = os.fstat(file.fileno()).st_size
        with zipfile.ZipFile(file) as archive:
            refuse_twins(archive)
            unpacked = sum(entry.file_size for entry in archive.infolist())
            limit = max(UNPACKED, TIMES * size)
            if unpacked > limit:
                raise InputError(
                    f"unpacks to {unpacked / 1e6:.0f} MB, and {limit / 1e6:.0f} MB are the most "
                    "of a file of its size"
                )
            refuse_beyond_memory("reading it", 2.0 * unpacked, "free some")
            arrays = {}
            for entry in archive.infolist():
                name = entry.filename.removesuffix(".npy")
                with reading(f"array {printable(name)}"):
                    arrays[name] = _array(archive.read(entry))
    return arrays


def read_array(path: Path | str) -> np.ndarray:
    """The array in an `.npy`, read-only, which may hold no objects.

    Raises:
        InputError: naming the file: as `read_bytes`, and for another content.
    """
    with reading(path, "an array of numpy"):
        return _array(read_bytes(path, UNPACKED))


def _array(content: bytes) -> np.ndarray:
    """The array in an `.npy`, whose header says as many bytes as there are."""
    stream = io.BytesIO(content)
    version = np.lib.format.read_magic(stream)
    if version not in HEADERS:
        raise InputError(f"of version {version} of the format, which is for objects")
    shape, is_fortran, dtype = HEADERS[version](stream)
    if dtype.hasobject:
        raise InputError("holds objects, whose reading would run code")
    rest = len(content) - stream.tell()
    # In Python's integers, which do not overflow.
    if math.prod(shape) * dtype.itemsize != rest:
        raise InputError(f"{rest} bytes for shape {list(shape)[:8]} of {dtype}")
    values = np.frombuffer(content, dtype, offset=stream.tell())
    return values.reshape(shape, order="F" if is_fortran else "C")


def refuse_twins(archive: zipfile.ZipFile) -> None:
    """Refuse a zip archive with two entries of one name, which two readers read differently.

    Names are compared without regard to case, as torch does, and `a` is `a.npy` to
    numpy. An entry has its name twice, in the directory and at its place; both must be
    the same.

    Raises:
        InputError: naming the first.
        BadZipFile: for an entry with two names.
    """
    for entry in archive.infolist():
        archive.open(entry).close()
    names = Counter(
        entry.filename.replace("\\", "/").casefold().removesuffix(".npy")
        for entry in archive.infolist()
    )
    for name, count in names.most_common(1):
        if count > 1:
            raise InputError(
                f"refused: {count} entries have the name {printable(name)[:80]}, "
                "and readers would take one or the other"
            )


def refuse_dense(path: Path | str, values: float) -> None:
    """Refuse a packed table that says to have more values than a file of its size can hold.

    Raises:
        InputError: naming the file, and both numbers.
    """
    limit = max(VALUES, DENSITY * os.stat(path).st_size)
    if values > limit:
        raise InputError(
            f"{printable(str(path))}: {values:.3g} values, and {limit:.3g} are the most of a file "
            "of its size: unpacked it would take any memory"
        )
