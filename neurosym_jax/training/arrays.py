"""Arrays on disk, through Orbax, and their digest.

This is the only importer of Orbax, which is imported when a folder is first read or written. What a
model's folder holds is said in `model_folder`, what a run's in
`training/checkpoints`.
"""

import hashlib
from pathlib import Path
from typing import Any

import jax
import numpy as np

from neurosym_jax.errors import InputError

__all__ = ["digest", "read_arrays", "write_arrays"]


def digest(tree: Any) -> str:
    """SHA-256 of a tree's paths, shapes, types and bytes.

    Orbax restores some flipped bits without noticing.
    """
    sha = hashlib.sha256()
    for path, leaf in jax.tree_util.tree_leaves_with_path(tree):
        array = np.ascontiguousarray(leaf)
        sha.update(f"{jax.tree_util.keystr(path)} {array.dtype} {array.shape}".encode())
        sha.update(array.tobytes())
    return sha.hexdigest()


def write_arrays(folder: Path, tree: Any) -> None:
    """Write a nested dictionary of arrays as a new folder."""
    from orbax.checkpoint import v1 as ocp

    ocp.save(str(folder.absolute()), tree)


def read_arrays(folder: Path) -> Any:
    """Read what `write_arrays` wrote.

    Raises:
        InputError: for a folder that is missing or damaged; not every damage is noticed, which is
            what `digest` is for.
    """
    from orbax.checkpoint import v1 as ocp

    try:
        return ocp.load(str(folder.absolute()))
    except Exception as error:  # Orbax and its storage raise many kinds for a damaged folder
        reason = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise InputError(f"{folder}: the parameters cannot be read ({reason[:200]})") from None
