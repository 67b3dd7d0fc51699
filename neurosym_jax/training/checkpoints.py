"""The states of a training run on disk: whole or not at all, verified, the two newest.

Each is a folder `step_00000120` of `state/` (arrays, Orbax's), `record.json` and
`sha256`, the digest of the others: Orbax restores some flipped bits without noticing,
and a flipped bit in a shape asks for any amount of memory. One process at a time writes
to a folder.
"""

import contextlib
import errno
import json
import os
import shutil
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import jax
import numpy as np

from neurosym_jax.errors import InputError, TrainingError
from neurosym_jax.runtime.files import folder_digest, new_folder, refuse_unwritable

__all__ = ["restore_state", "save_state", "sole_writer"]

STATE, RECORD, DIGEST = "state", "record.json", "sha256"
SPARE = 2**20
"""Bytes beyond the arrays that a state may need on the disk."""


def save_state(folder: Path, step: int, state: Any, record: dict[str, Any]) -> None:
    """Save the state after `step` steps, a pytree of arrays, then remove all but the two newest.

    It is on the disk when this returns. `record` is JSON-able.

    Raises:
        TrainingError: where it cannot be written.
    """
    from orbax.checkpoint import v1 as ocp

    path = folder / f"step_{step:08d}"
    # By number, because Orbax or the file system may read a leaf's path otherwise.
    leaves = {
        f"{at:06d}": np.asarray(leaf) for at, leaf in enumerate(jax.tree.leaves(state))
    }
    context = ocp.Context()
    # In the background, Orbax waits twenty minutes for a folder that cannot be made.
    context.asynchronous.create_directories_asynchronously = False
    try:
        for left in folder.glob(".step_*"):  # By a process that was killed.
            shutil.rmtree(left)
        with new_folder(path) as new:
            # Asked before, because Orbax prints thirty tracebacks on a full disk.
            if (
                shutil.disk_usage(new).free
                < sum(leaf.nbytes for leaf in leaves.values()) + SPARE
            ):
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
            with context:
                ocp.save(str((new / STATE).absolute()), leaves)
            (new / RECORD).write_text(json.dumps(record, allow_nan=False))
            (new / DIGEST).write_text(folder_digest(new))
        for old in _steps(folder)[:-2]:
            shutil.rmtree(old)
    except Exception as error:  # Orbax and its storage raise many kinds.
        text = (
            str(error) if isinstance(error, InputError) else f"{path}: {_reason(error)}"
        )
        raise TrainingError(f"{text}; what was saved before is kept") from error


def restore_state(
    folder: Path,
    template: Any,
    check: Callable[[dict[str, Any]], object] = lambda record: None,
) -> tuple[Any, dict[str, Any]] | None:
    """The newest whole state, in the structure of `template`, and its record; None without any.

    Its leaves are numpy arrays, bit for bit those saved. Damaged states are renamed to
    `damaged_...`, with a warning. `check` may refuse the record before the state is
    compared.

    Raises:
        InputError: where a whole state has other arrays than `template`.
    """
    from orbax.checkpoint import v1 as ocp

    for path in reversed(_steps(folder)):
        try:
            if folder_digest(path, DIGEST) != (path / DIGEST).read_text():
                raise ValueError("its files do not match their digest")
            record = json.loads((path / RECORD).read_bytes())
            arrays: Any = ocp.load(str((path / STATE).absolute()))
        except (
            Exception
        ) as error:  # Orbax and its storage raise many kinds for damaged files.
            print(f"warning: {path}: is damaged: {_reason(error)}", file=sys.stderr)
            aside = path.with_name(f"damaged_{path.name}")
            shutil.rmtree(aside, ignore_errors=True)
            path.rename(aside)
            continue
        check(record)
        leaves, structure = jax.tree.flatten(template)
        leaves_saved = [arrays[name] for name in sorted(arrays)]
        if [(leaf.shape, leaf.dtype) for leaf in leaves_saved] != [
            (x.shape, x.dtype) for x in leaves
        ]:
            raise InputError(f"{folder}: holds another run: its network differs")
        return jax.tree.unflatten(structure, leaves_saved), record
    return None


@contextlib.contextmanager
def sole_writer(folder: Path) -> Iterator[None]:
    """Lock `folder`, which is created if needed; the lock ends with the process.

    Raises:
        InputError: when another process holds it, or nothing can be written there.
    """
    refuse_unwritable(folder / ".lock")
    folder.mkdir(parents=True, exist_ok=True)
    with (folder / ".lock").open("w") as file:
        try:
            import fcntl

            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except ImportError:  # Not on Windows, where nothing guards the folder.
            pass
        except BlockingIOError:
            raise InputError(f"{folder}: another process is training there") from None
        yield


def _steps(folder: Path) -> list[Path]:
    return sorted(path for path in folder.glob("step_*") if path.name[5:].isdecimal())


def _reason(error: Exception) -> str:
    return str(error).splitlines()[0][:200] if str(error) else type(error).__name__
