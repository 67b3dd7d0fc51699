"""The states of a training run on disk: whole or not at all, verified, the two newest.

Each is a folder `step_00000120` of `state.safetensors` (arrays by number), `record.json` and
`sha256`, the digest of the others, which is compared before they are parsed. One process at a time
writes to a folder.
"""

import contextlib
import json
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

STATE, RECORD, DIGEST = "state.safetensors", "record.json", "sha256"


def save_state(folder: Path, step: int, state: Any, record: dict[str, Any]) -> None:
    """Save the state after `step` steps, a pytree of arrays, then remove all but the two newest.

    It is on the disk when this returns. `record` is JSON-able.

    Raises:
        TrainingError: where it cannot be written.
    """
    from safetensors.numpy import save

    path = folder / f"step_{step:08d}"
    leaves = enumerate(jax.tree.leaves(state))
    content = save({f"{at:06d}": np.array(leaf, order="C") for at, leaf in leaves})
    try:
        for left in folder.glob(".step_*"):  # By a process that was killed.
            shutil.rmtree(left)
        with new_folder(path) as new:
            (new / STATE).write_bytes(content)
            (new / RECORD).write_text(json.dumps(record, allow_nan=False))
            (new / DIGEST).write_text(folder_digest(new))
        for old in _steps(folder)[:-2]:
            shutil.rmtree(old)
    except (InputError, OSError) as error:
        raise TrainingError(f"{error}; what was saved before is kept") from error


def restore_state(
    folder: Path, template: Any, check: Callable[[dict[str, Any]], object] = lambda record: None
) -> tuple[Any, dict[str, Any]] | None:
    """The newest whole state, in the structure of `template`, and its record; None without any.

    Its leaves are numpy arrays, bit for bit those saved. Damaged states are renamed to
    `damaged_...`, with a warning. `check` may refuse the record before the state is compared.

    Raises:
        InputError: where a whole state has other arrays than `template`.
    """
    from safetensors.numpy import load_file

    for path in reversed(_steps(folder)):
        try:
            if folder_digest(path, DIGEST) != (path / DIGEST).read_text():
                raise ValueError("its files do not match their digest")
            record = json.loads((path / RECORD).read_bytes())
            arrays = load_file(path / STATE)
        except (OSError, ValueError) as error:
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
