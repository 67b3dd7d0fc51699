"""Compiled programs kept between processes, each with the digest that is checked before it runs.

JAX trusts what lies in its cache: a flipped bit can end the process or change a
forecast. JAX has no public way to check an entry, so the cache replaces the one that
JAX would open.
"""

import contextlib
import hashlib
import os
import secrets
import stat
import sys
import threading
from collections.abc import Iterator
from pathlib import Path

import jax
from jax._src import compilation_cache
from jax._src.compilation_cache_interface import CacheInterface

from neurosym_jax.errors import printable

__all__ = [
    "LIMIT",
    "SealedCache",
    "apart_from_cache",
    "keep_programs",
    "private_folder",
]

LIMIT = 1_000_000_000
"""Bytes that the folder may have; one model's programs take about 10 MB."""
SEAL = hashlib.sha256().digest_size
OTHERS = stat.S_IWGRP | stat.S_IWOTH
"""Permissions by which others than the owner may write."""

_thread = threading.local()


class SealedCache(CacheInterface):
    """A folder of programs, each in a file `KEY.program`: the SHA-256 of key and program, then it.

    A file is written under another name and renamed. One that does not match its digest
    is removed, so that JAX compiles the program again; the first prints a line. Beyond
    `limit` bytes the files that were used least recently go. A disk that fails costs
    time only: the program is compiled.
    """

    def __init__(self, folder: Path, limit: int = LIMIT):
        self._path, self.limit, self.reported = folder, limit, False

    def get(self, key: str) -> bytes | None:
        """The program of a key; None where there is none, or a damaged one, which is removed."""
        path = self._file(key)
        try:
            content = path.read_bytes()
            if content[:SEAL] == _seal(key, content[SEAL:]):
                with contextlib.suppress(OSError):  # A folder that is only read.
                    os.utime(path)
                return content[SEAL:]
            path.unlink()
        except OSError:
            return None
        if not self.reported:
            self.reported = True
            folder = printable(str(self._path))
            print(
                f"warning: {folder}: damaged programs are compiled again",
                file=sys.stderr,
            )
        return None

    def put(self, key: str, value: bytes) -> None:
        """Keep a program."""
        beside = self._path / f".{secrets.token_hex(8)}"
        with contextlib.suppress(OSError):
            self._path.mkdir(parents=True, exist_ok=True)
            try:
                beside.write_bytes(_seal(key, value) + value)
                beside.replace(self._file(key))
            finally:
                beside.unlink(missing_ok=True)
            self._shrink()

    def _file(self, key: str) -> Path:
        return self._path / f"{key}.program"

    def _shrink(self) -> None:
        """Remove the files that were used least recently, also those of other versions."""
        sizes = {
            entry.path: entry.stat()
            for entry in os.scandir(self._path)
            if entry.is_file()
        }
        excess = sum(status.st_size for status in sizes.values()) - self.limit
        for path in sorted(sizes, key=lambda path: sizes[path].st_mtime_ns):
            if excess <= 0:
                break
            Path(path).unlink(missing_ok=True)
            excess -= sizes[path].st_size


class _JaxCache(CacheInterface):
    """The `SealedCache` that JAX asks; empty within `apart_from_cache`."""

    def __init__(self, folder: Path):
        self._path, self._cache = folder, SealedCache(folder)

    def get(self, key: str) -> bytes | None:
        """See `SealedCache.get`."""
        if getattr(_thread, "apart", False):
            return None
        return self._cache.get(key)

    def put(self, key: str, value: bytes) -> None:
        """See `SealedCache.put`."""
        if not getattr(_thread, "apart", False):
            self._cache.put(key, value)


@contextlib.contextmanager
def apart_from_cache() -> Iterator[None]:
    """Compile in this thread without JAX's cache: a program from there cannot be serialised."""
    _thread.apart = True
    try:
        yield
    finally:
        _thread.apart = False


def private_folder(folder: Path) -> bool:
    """Whether `folder`, which is made if it is missing, is the user's and only theirs to write.

    Others could let this process run their code, so their permission is withdrawn.
    """
    try:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        status = folder.lstat()
        if not stat.S_ISDIR(status.st_mode):
            return False
        if hasattr(os, "getuid") and status.st_uid != os.getuid():
            return False
        if status.st_mode & OTHERS:
            folder.chmod(stat.S_IMODE(status.st_mode) & ~OTHERS)
    except OSError:
        return False
    return True


def keep_programs(folder: Path) -> None:
    """Let JAX keep the programs it compiles from now on in `folder`.

    In a version of JAX whose cache cannot be replaced, nothing is kept.
    """
    if not hasattr(compilation_cache, "get_file_cache"):
        return
    compilation_cache.get_file_cache = lambda path: (_JaxCache(Path(path)), path)
    compilation_cache.reset_cache()
    jax.config.update("jax_compilation_cache_dir", str(folder))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
    jax.config.update("jax_persistent_cache_min_entry_size_bytes", 0)
    # On a GPU XLA would keep files of its own there, without a digest.
    jax.config.update("jax_persistent_cache_enable_xla_caches", "none")


def _seal(key: str, value: bytes) -> bytes:
    return hashlib.sha256(key.encode() + b"\0" + value).digest()
