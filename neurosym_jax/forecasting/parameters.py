"""Parameters as arrays by path, such as `params/mlp/bias`, and the check that they fit."""

from collections.abc import Mapping
from typing import Any

import jax
import numpy as np

from neurosym_jax.errors import InputError

__all__ = ["flat_parameters", "nested_parameters", "refuse_misfit", "shapes_of"]


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


def refuse_misfit(
    arrays: Mapping[str, np.ndarray], expected: Mapping[str, Any], message: str
) -> None:
    """Refuse arrays [...] whose names and shapes are not those `wanted`, or that are not finite.

    Raises:
        InputError: naming the first of them; `what` is what it says of misfits.
    """
    wrong = [
        f"{name!r} is {arrays[name].shape if name in arrays else 'missing'}, "
        f"not {expected.get(name, 'expected')}"
        for name in {**expected, **arrays}
        if name not in arrays or arrays[name].shape != expected.get(name)
    ]
    infinite = [name for name, array in arrays.items() if not np.isfinite(array).all()]
    for misfits, text in ((wrong, message), (infinite, "parameters that are not finite")):
        if misfits:
            rest = f" and {len(misfits) - 6} more" if len(misfits) > 6 else ""
            raise InputError(f"{text}: {', '.join(misfits[:6])}{rest}")


def _leaves(params: Any) -> list[tuple[str, Any]]:
    leaves = jax.tree_util.tree_leaves_with_path(params)
    return [(jax.tree_util.keystr(path, simple=True, separator="/"), leaf) for path, leaf in leaves]
