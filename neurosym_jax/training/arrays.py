"""The arrays of a training run's states on disk, through Orbax, and their digest.

This is the only importer of Orbax, which is imported when a folder is first read or written.
"""

import hashlib
from pathlib import Path
from typing import Any

import jax
import numpy as np

from neurosym_jax.errors import InputError

__all__ = ["array_shapes", "digest", "read_arrays", "write_arrays"]


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

    context = ocp.Context()
    # In the background, a folder that cannot be made would be waited for, for twenty minutes.
    context.asynchronous.create_directories_asynchronously = False
    with context:
        ocp.save(str(folder.absolute()), tree)


def read_arrays(folder: Path) -> Any:
    """Read what `write_arrays` wrote.

    Raises:
        InputError: for a folder that is missing or damaged; not every damage is noticed, which is
            what `digest` is for.
    """
    return _orbax(folder, "load")


def array_shapes(folder: Path) -> list[tuple[int, ...]]:
    """The shapes of the arrays that `write_arrays` wrote, which are not read.

    Raises:
        InputError: for a folder that is missing or damaged.
    """
    return [leaf.shape for leaf in jax.tree.leaves(_orbax(folder, "metadata").metadata)]


def _orbax(folder: Path, function: str) -> Any:
    from orbax.checkpoint import v1 as ocp

    try:
        return getattr(ocp, function)(str(folder.absolute()))
    except Exception as error:  # Orbax and its storage raise many kinds for a damaged folder
        reason = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise InputError(f"{folder}: the parameters cannot be read ({reason[:200]})") from None
