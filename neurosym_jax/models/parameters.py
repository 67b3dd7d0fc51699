"""Parameters as arrays by path, such as `params/mlp/bias`, and the check that they fit."""

from collections.abc import Mapping
from typing import Any

import jax
import numpy as np

from neurosym_jax.errors import InputError, brief

__all__ = [
    "flat_parameters",
    "leaves_by_path",
    "nested_parameters",
    "refuse_misfit",
    "refuse_other_tree",
    "shapes_of",
]

DEPTH = 32
"""Parts of a path; jax's trees overflow the stack at some ten thousand."""


def flat_parameters(params: Any) -> dict[str, np.ndarray]:
    """The arrays of nested dictionaries by path.

    Raises:
        InputError: for a tree that would not come back: not dictionaries, empty ones,
            names with a `/`, leaves that are not arrays of numbers.
    """
    refuse_other_tree(params)
    flat = {name: np.asarray(leaf, order="C") for name, leaf in leaves_by_path(params)}
    for name, array in flat.items():
        if array.dtype.kind not in "fiub" or array.dtype.itemsize > 8:
            raise InputError(f"the parameter {name} is not an array of numbers")
    return flat


def refuse_other_tree(params: Any) -> None:
    """Refuse what is no tree of nested dictionaries, as of an Equinox module.

    Raises:
        InputError: for a tree that would not come back from its paths.
    """
    again = nested_parameters(dict(leaves_by_path(params)))
    if jax.tree.structure(again) != jax.tree.structure(params):
        raise InputError(
            "parameters must be nested dictionaries of arrays, by names without a '/'"
        )


def nested_parameters(flat: Mapping[str, Any]) -> dict[str, Any]:
    """The inverse of `flat_parameters`.

    Raises:
        InputError: for paths of more than `DEPTH` parts, and two of which one begins
            the other.
    """
    params: dict[str, Any] = {}
    for path, value in flat.items():
        *scope, name = path.split("/")
        if len(scope) >= DEPTH:
            raise InputError(
                f"the parameter {brief(path)} has a path of {len(scope) + 1} parts"
            )
        node = params
        for part in scope:
            node = node.setdefault(part, {})
            if not isinstance(node, dict):
                break
        if not isinstance(node, dict) or name in node:
            raise InputError(
                f"{brief(path)}: the name of a parameter and of a folder of others"
            )
        node[name] = value
    return params


def shapes_of(params: Any) -> dict[str, tuple[int, ...]]:
    """Shapes of the arrays [...] of nested dictionaries by path."""
    return {name: leaf.shape for name, leaf in leaves_by_path(params)}


def refuse_misfit(
    arrays: Mapping[str, np.ndarray], expected: Mapping[str, Any], message: str
) -> None:
    """Refuse arrays [...] whose names and shapes are not those `expected`, or that are not finite.

    Raises:
        InputError: naming the first of them; `message` is what it says of misfits.
    """
    misfits = [
        f"{brief(name)} is {arrays[name].shape if name in arrays else 'missing'}, "
        f"not {expected.get(name, 'expected')}"
        for name in {**expected, **arrays}
        if name not in arrays or arrays[name].shape != expected.get(name)
    ]
    if not misfits:
        message = "parameters that are not finite"
        misfits = [
            name for name, array in arrays.items() if not np.isfinite(array).all()
        ]
    if misfits:
        rest = f" and {len(misfits) - 6} more" if len(misfits) > 6 else ""
        raise InputError(f"{message}: {', '.join(misfits[:6])}{rest}")


def leaves_by_path(params: Any) -> list[tuple[str, Any]]:
    """Path and leaf of each array of nested dictionaries."""
    leaves = jax.tree_util.tree_leaves_with_path(params)
    return [
        (jax.tree_util.keystr(path, simple=True, separator="/"), leaf)
        for path, leaf in leaves
    ]
