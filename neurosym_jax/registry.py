"""A registry: a dictionary of named components that plugins can add to.

Each room shows its built-ins in one table, such as `POOLINGS = Registry("pooling", {...})`; a file
given by `--plugin`, or an installed package, adds to it with `register`.
"""

import difflib
import functools
from collections.abc import Mapping
from typing import Any, TypeVar

from neurosym_jax.errors import InputError

__all__ = ["Registry"]

T = TypeVar("T")


class Registry(dict[str, T]):
    """Components of one kind by name, in the order in which they were registered."""

    def __init__(self, kind: str, built_in: Mapping[str, T] | None = None):
        """Hold `built_in`; `kind` is what messages call one of them, such as "pooling"."""
        super().__init__(built_in or {})
        self.kind = kind

    def register(self, name: str, value: T | None = None, *, replace: bool = False) -> Any:
        """Add `value` and return it; without `value`, return a decorator of the component.

        `replace` replaces another component of this name, and clears JAX's compilation cache, which
        finds programs by name.

        Raises:
            InputError: if `name` is not an identifier or is taken by another component.
        """
        if value is None:
            return functools.partial(self.register, name, replace=replace)
        if not name.isidentifier():
            raise InputError(f"{name!r} cannot name a {self.kind}: letters, digits, underscores")
        if self.get(name, value) != value:
            if not replace:
                raise InputError(
                    f"there is another {self.kind} {name!r} already: choose another name, or say "
                    "replace=True"
                )
            import jax

            jax.clear_caches()
        self[name] = value
        return value

    def name_of(self, value: Any) -> str:
        """The name of `value`, or of its class.

        Raises:
            InputError: if neither is registered.
        """
        for name, each in self.items():
            if each is value or each is type(value):
                return name
        raise InputError(f"{value!r} is not registered as a {self.kind}")

    def __missing__(self, name: str) -> T:
        near = difflib.get_close_matches(str(name), self, 1)
        hint = f"did you mean {near[0]!r}? " if near else ""
        known = ", ".join(self)
        raise InputError(
            f"unknown {self.kind} {name!r}: {hint}there are {known} (--plugin FILE adds one)"
        )
