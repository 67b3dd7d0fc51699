"""Files and folders that are replaced whole: written beside their place, synced, then renamed.

If the process is killed or the disk is full, the old file is still there.
"""

import contextlib
import ctypes
import errno
import hashlib
import json
import os
import re
import secrets
import shutil
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from neurosym_jax.errors import InputError
from neurosym_jax.runtime.ending import when_ended

__all__ = [
    "append_text",
    "folder_digest",
    "new_file",
    "new_folder",
    "refuse_unwritable",
    "remove_half_written",
]
__all__ += ["replaced_folder", "write_json", "write_text"]

_HERE, _EXCHANGE = -100, 2
"""AT_FDCWD and RENAME_EXCHANGE of Linux."""


def new_file(path: Path | str) -> contextlib.AbstractContextManager[Path]:
    """A context with the path of a temporary file, which replaces `path` unless there is an error.

    A missing folder is made. Where `path` cannot be written, an `InputError` says why.
    """
    return _beside(Path(path), Path.touch)


def new_folder(path: Path | str) -> contextlib.AbstractContextManager[Path]:
    """A context with the path of a temporary folder, which becomes `path` unless there is an error.

    Raises:
        InputError: if `path` exists or cannot be written.
    """
    if os.path.exists(path):  # os's also for a name that is too long.
        raise InputError(f"{path}: already there, and nothing is overwritten")
    return _beside(Path(path), Path.mkdir)


def replaced_folder(path: Path | str) -> contextlib.AbstractContextManager[Path]:
    """As `new_folder`, but what is at `path` is replaced: at no moment is nothing there."""
    return _beside(Path(path), Path.mkdir)


def _replace(beside: Path, path: Path) -> None:
    """Put a file or folder in the place of another, which is removed."""
    if not (beside.is_dir() and path.exists()):
        beside.replace(path)
        return
    with contextlib.suppress(
        AttributeError, OSError
    ):  # Other systems, old C libraries.
        exchange = ctypes.CDLL(None).renameat2
        names = (os.fsencode(beside), os.fsencode(path))
        if exchange(_HERE, names[0], _HERE, names[1], _EXCHANGE) == 0:
            shutil.rmtree(beside)
            return
    old = beside.with_name(f"{beside.name}.old")
    path.replace(old)
    beside.replace(path)
    shutil.rmtree(old)


@contextlib.contextmanager
def _beside(path: Path, make: Callable[[Path], None]) -> Iterator[Path]:
    with _in_words(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        # Writers of figures need the ending; a name of maximal length has no room for
        # more.
        beside = path.with_name(
            f".{path.stem[:100]}.{secrets.token_hex(4)}{path.suffix}"
        )

        def remove() -> None:
            shutil.rmtree(beside, ignore_errors=True)
            with contextlib.suppress(OSError):  # It is a folder, or in its place.
                beside.unlink()

        with when_ended(remove):
            make(beside)
            yield beside
            for content in (*beside.rglob("*"), beside):
                _sync(content)
            _replace(beside, path)
            _sync(path.parent)


def remove_half_written(folder: Path, stems: str) -> None:
    """Remove what a process that was killed has left of files and folders in `folder`.

    `stems` is a pattern of their names without ending. Nobody else may write there.
    """
    pattern = re.compile(rf"\.({stems})\.[0-9a-f]{{8}}(\.\w+)?")
    if not folder.is_dir():
        return
    paths = [path for path in folder.iterdir() if pattern.fullmatch(path.name)]
    for path in paths:
        shutil.rmtree(path, ignore_errors=True)
        with contextlib.suppress(OSError):  # It was a folder.
            path.unlink()


def write_text(path: Path | str, text: str) -> None:
    """Replace `path` by `text` in UTF-8."""
    with new_file(path) as beside:
        beside.write_text(text, encoding="utf-8")


def append_text(path: Path | str, text: str) -> None:
    """Append `text` to a log; a killed process may leave a part of it."""
    path = Path(path)
    with _in_words(path), path.open("a", encoding="utf-8") as file:
        file.write(text)


def write_json(path: Path | str, data: Any) -> None:
    """Replace `path` by `data` in strict JSON: a ValueError for a NaN or an infinity."""
    write_text(path, json.dumps(data, indent=1, allow_nan=False) + "\n")


def folder_digest(folder: Path, without: str = "") -> str:
    """SHA-256 of the names and bytes of all files below `folder` but the one named `without`."""
    sha = hashlib.sha256()
    for path in sorted(folder.rglob("*")):
        name = path.relative_to(folder).as_posix()
        if path.is_file() and name != without:
            sha.update(f"{name}\0{path.stat().st_size}\0".encode())
            sha.update(path.read_bytes())
    return sha.hexdigest()


def refuse_unwritable(path: Path | str) -> None:
    """Refuse a path that cannot be written, before the work and not after it.

    Raises:
        InputError: naming `path` and the reason.
    """
    path = Path(path)
    with _in_words(path):
        if path.is_dir():
            raise IsADirectoryError(errno.EISDIR, "it is a folder")
        if path.exists() and not path.is_file():  # A device may be read without an end.
            raise OSError(errno.EINVAL, "it is no file")
        folder = next(folder for folder in path.absolute().parents if folder.exists())
        with tempfile.TemporaryFile(dir=folder):
            pass


def _sync(path: Path) -> None:
    """Wait until a file, or the entries of a folder, are on the disk."""
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


@contextlib.contextmanager
def _in_words(path: Path) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        reason = error.strerror or type(error).__name__
        raise InputError(f"{path}: cannot be written ({reason})") from None
