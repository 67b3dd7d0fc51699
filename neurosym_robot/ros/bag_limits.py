"""Limits of memory and time for bags with compressed content.

rosbags decompresses whole chunks, whatever their size: a bag of 24 kB can take
gigabytes. So such a bag is read once beforehand by a process with limits, `python -m
neurosym_robot.ros.bag_limits`.
"""

import errno
import math
import mmap
import os
import signal
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

from neurosym_jax.errors import InputError

MEMORY, TIMES = 256_000_000, 10
"""Bytes that reading may take, or as many times the bag's if that is more."""
SECONDS, RATE = 20, 5e6
"""Seconds that it may take, and bytes of the bag for each further one."""
TOO_LARGE = 3  # exit status
WORDS = (b"compression=lz4", b"compression=bz2", b"zstd", b"lz4")


def refuse_bombs(bag: Path, paths: Sequence[Path]) -> None:
    """InputError for a bag of `paths` that would take too much memory or time, with the limit."""
    inside = []
    for path in paths:
        inside += [file for file in (path, *path.glob("*")) if file.is_file()]
    if not any(map(_compressed, inside)):
        return
    size = sum(file.stat().st_size for file in inside)
    limit, seconds = max(MEMORY, TIMES * size), SECONDS + size / RATE
    command = [sys.executable, "-m", __name__, str(limit), str(math.ceil(seconds))]
    command += map(str, paths)
    try:
        # The process counts its own time; on a busy computer that is less than what
        # passes.
        status = subprocess.run(
            command, capture_output=True, timeout=10 * seconds
        ).returncode
        if status == -signal.SIGXCPU:
            raise subprocess.TimeoutExpired(command, seconds)
    except subprocess.TimeoutExpired:
        raise InputError(
            f"{bag}: takes more than {seconds:.0f} s to decompress"
        ) from None
    if status == TOO_LARGE or status < 0:  # Killed, it took too much, too.
        raise InputError(
            f"{bag}: takes more than {limit / 1e6:.0f} MB of memory to decompress"
        )


def _compressed(file: Path) -> bool:
    """Whether a file says that something in it is compressed; it may be larger than memory."""
    with file.open("rb") as content:
        size = file.stat().st_size
        data = mmap.mmap(content.fileno(), 0, access=mmap.ACCESS_READ) if size else b""
        return any(data.find(word) >= 0 for word in WORDS)


def _read_all(limit: int, seconds: int, paths: Sequence[Path]) -> int:
    """Read a bag with `limit` bytes more than now within `seconds`; the exit status."""
    import resource

    from neurosym_robot.ros.definitions import shared_typestore

    store = shared_typestore(2)
    from rosbags.highlevel import AnyReader

    used = int(Path("/proc/self/statm").read_text().split()[0]) * os.sysconf(
        "SC_PAGE_SIZE"
    )
    resource.setrlimit(resource.RLIMIT_AS, (used + limit, used + limit))
    spent = math.ceil(sum(os.times()[:2]))
    resource.setrlimit(resource.RLIMIT_CPU, (spent + seconds, spent + seconds + 5))
    resource.setrlimit(
        resource.RLIMIT_FSIZE, (limit, limit)
    )  # of what is unpacked on the disk
    try:
        with AnyReader(paths, default_typestore=store) as reader:
            for _ in reader.messages():
                pass
    except Exception as error:
        words = f"{type(error).__name__} {error} {error.__cause__!r}".lower()
        full = isinstance(error, OSError) and error.errno in (errno.EFBIG, errno.ENOMEM)
        return TOO_LARGE if full or "memory" in words or "alloc" in words else 0
    return 0


if __name__ == "__main__":
    paths = [Path(path) for path in sys.argv[3:]]
    sys.exit(_read_all(int(sys.argv[1]), int(sys.argv[2]), paths))
