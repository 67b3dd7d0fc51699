"""The states of a training run on disk: a file for each step, whole or not at all, verified.

`step_00000120.state` holds a SHA-256 digest, then the state's arrays in safetensors, whose
metadata is the caller's record. The two newest steps are kept. One process at a time writes.
"""

import contextlib
import hashlib
import json
import sys
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from neurosym_jax.errors import InputError, TrainingError
from neurosym_jax.runtime.files import new_file

__all__ = ["restore_state", "save_state", "saved_steps"]

DIGEST = hashlib.sha256().digest_size


def save_state(folder: Path, step: int, state: Any, record: dict[str, Any]) -> None:
    """Save one step, durably, then remove all but the two newest.

    Args:
        folder: of the states of one run.
        step: greater than any saved before.
        state: pytree of jax or numpy arrays.
        record: JSON-able.

    Raises:
        TrainingError: before anything is written, where a leaf is not finite, the record is not
            JSON or the step is not a new one; and where it cannot be written.
    """
    from safetensors.numpy import save

    saved = saved_steps(folder)
    if saved and step <= saved[-1]:
        raise TrainingError(
            f"{folder}: step {step} is not after step {saved[-1]}, which is already there: resume "
            "that run, or choose another folder"
        )
    end = f": step {step} is not saved" + (f"; step {saved[-1]} is kept" if saved else "")
    leaves = {path: np.array(leaf, order="C") for path, leaf in _by_path(state).items()}
    for path, leaf in leaves.items():
        if jnp.issubdtype(leaf.dtype, jnp.inexact) and not np.isfinite(leaf).all():
            raise TrainingError(f"{folder}: state{path} is not finite{end}")
    try:
        text = json.dumps(record, allow_nan=False)
    except (TypeError, ValueError) as error:
        raise TrainingError(f"{folder}: the record is not JSON ({error}){end}") from None
    content = save(leaves, metadata={"record": text})
    try:
        with new_file(_path(folder, step)) as beside:
            beside.write_bytes(hashlib.sha256(content).digest() + content)
    except InputError as error:
        raise TrainingError(f"{error}; what was saved before is kept") from None
    for old in saved[:-1]:
        _path(folder, old).unlink()


def restore_state(folder: Path, template: Any) -> tuple[int, Any, dict[str, Any]] | None:
    """The newest whole step, as `(step, state, record)`; None where there is none.

    Damaged steps are renamed to `damaged_...`, with a warning on stderr.

    Args:
        folder: of the states of one run.
        template: pytree of arrays (or of their shapes and types) with the state's structure.

    Returns:
        `state` has numpy arrays for leaves, bit for bit those saved.

    Raises:
        TrainingError: where a whole step has other leaves than `template`.
    """
    from safetensors.numpy import load

    for step in reversed(saved_steps(folder)):
        path = _path(folder, step)
        whole = path.read_bytes()
        digest, content = whole[:DIGEST], whole[DIGEST:]
        if hashlib.sha256(content).digest() != digest:
            print(f"warning: {path}: damaged, and passed over", file=sys.stderr)
            with contextlib.suppress(OSError):  # A folder that cannot be written can be read.
                path.rename(path.with_name(f"damaged_{path.name}"))
            continue
        found, wanted = load(content), _by_path(template)
        for name in [*wanted, *found]:
            there, here = _kind(found.get(name)), _kind(wanted.get(name))
            if there != here:
                raise TrainingError(
                    f"{path}: of another configuration: state{name} is {there} there and {here} "
                    "here"
                )
        header = json.loads(content[8 : 8 + int.from_bytes(content[:8], "little")])
        state = jax.tree.unflatten(jax.tree.structure(template), [found[name] for name in wanted])
        return step, state, json.loads(header["__metadata__"]["record"])
    return None


def saved_steps(folder: Path) -> list[int]:
    """The steps in `folder`, in order."""
    names = (path.stem.removeprefix("step_") for path in folder.glob("step_*.state"))
    return sorted(int(name) for name in names if name.isdecimal())


def _path(folder: Path, step: int) -> Path:
    return folder / f"step_{step:08d}.state"


def _by_path(tree: Any) -> dict[str, Any]:
    pairs = jax.tree_util.tree_leaves_with_path(tree)
    return {jax.tree_util.keystr(path): leaf for path, leaf in pairs}


def _kind(leaf: Any) -> str:
    """Type and shape in words."""
    if leaf is None:
        return "absent"
    leaf = leaf if hasattr(leaf, "dtype") else np.asarray(leaf)
    return f"{leaf.dtype}{list(leaf.shape)}"
