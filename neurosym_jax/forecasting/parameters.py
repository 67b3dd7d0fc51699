"""Parameters: nested dictionaries of arrays, and flat, by path such as `params/mlp/bias`."""

from collections.abc import Mapping, Sequence
from typing import Any

import jax
import numpy as np

from neurosym_jax.errors import InputError

__all__ = ["flat_parameters", "listed", "misfits", "nested_parameters", "refuse_not_finite"]
__all__ += ["shapes_of"]

Shapes = Mapping[str, tuple[int, ...]]


def flat_parameters(params: Any) -> dict[str, np.ndarray]:
    """The arrays of nested dictionaries by path.

    Raises:
        InputError: for a tree that would not come back: not dictionaries, empty ones, names with a
            `/`, leaves that are not arrays of numbers.
    """
    flat = {name: np.asarray(leaf, order="C") for name, leaf in _leaves(params)}
    if jax.tree.structure(nested_parameters(flat)) != jax.tree.structure(params):
        raise InputError("parameters must be nested dictionaries of arrays, by names without a '/'")
    for name, array in flat.items():
        if array.dtype.kind not in "fiub" or array.dtype.itemsize > 8:
            raise InputError(f"the parameter {name} is not an array of numbers")
    return flat


def nested_parameters(flat: Mapping[str, Any]) -> dict[str, Any]:
    """The inverse of `flat_parameters`."""
    params: dict[str, Any] = {}
    for path, value in flat.items():
        *scope, name = path.split("/")
        node = params
        for part in scope:
            node = node.setdefault(part, {})
        node[name] = value
    return params


def shapes_of(params: Any) -> dict[str, tuple[int, ...]]:
    """Shapes of the arrays [...] of nested dictionaries by path."""
    return {name: leaf.shape for name, leaf in _leaves(params)}


def misfits(given: Shapes, wanted: Shapes) -> list[str]:
    """In words, each name whose shape is not the one that is wanted."""
    return [
        f"{name!r} is {given.get(name, 'missing')}, not {wanted.get(name, 'expected')}"
        for name in {**wanted, **given}
        if given.get(name) != wanted.get(name)
    ]


def refuse_not_finite(flat: Mapping[str, np.ndarray]) -> None:
    """Refuse arrays [...] that hold a NaN or an infinity.

    Raises:
        InputError: naming them.
    """
    bad = [name for name, value in flat.items() if not np.isfinite(value).all()]
    if bad:
        raise InputError(f"parameters that are not finite: {listed(bad)}")


def listed(names: Sequence[str], most: int = 6) -> str:
    """Names for a message: the first `most`, and how many more there are."""
    more = f" and {len(names) - most} more" if len(names) > most else ""
    return ", ".join(names[:most]) + more


def _leaves(params: Any) -> list[tuple[str, Any]]:
    leaves = jax.tree_util.tree_leaves_with_path(params)
    return [(jax.tree_util.keystr(path, simple=True, separator="/"), leaf) for path, leaf in leaves]
