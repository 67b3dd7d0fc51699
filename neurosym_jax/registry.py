"""Things of one kind by name: what a researcher adds to from a file of their own.

There is a registry for each of them: metrics, forecasters, poolings, weightings, formats. What the
package brings is registered in the same way as what a plugin adds (see `plugins`).
"""

import threading
from collections.abc import Callable, Iterator, Mapping
from typing import Generic, TypeVar

from neurosym_jax.errors import InputError

__all__ = ["Registry"]

Thing = TypeVar("Thing")


class Registry(Mapping[str, Thing], Generic[Thing]):
    """Things by name, in the order in which they were registered."""

    def __init__(self, kind: str, load: Callable[[], object] = lambda: None):
        """An empty registry.

        Args:
            kind: what the things are, in one word, for people.
            load: imports what registers what the package brings, before anything is looked up;
                called again, it changes nothing.
        """
        self.kind = kind
        self._load = load
        self._things: dict[str, Thing] = {}
        self._ready = self._loading = False
        self._lock = threading.RLock()

    def register(self, name: str, thing: Thing, *, replace: bool = False) -> None:
        """Add `thing` by this name.

        Args:
            name: letters, digits and underscores, as it is written in lists of names.
            thing: what is had by it; registering an equal one again changes nothing.
            replace: put it in the place of another of this name. Programs that were compiled with
                the other are forgotten.

        Raises:
            InputError: for what is no name, or one that is taken by another thing.
        """
        if not name.isidentifier():
            raise InputError(f"{name!r} cannot name a {self.kind}: letters, digits, underscores")
        self._built_in(registering=True)
        if name in self._things and self._things[name] != thing:
            if not replace:
                raise InputError(
                    f"there is another {self.kind} {name!r} already: choose another name, or say "
                    "replace=True"
                )
            import jax

            # A program is found by the names and values it was compiled for, which stay the same.
            jax.clear_caches()
        self._things[name] = thing

    def __getitem__(self, name: str) -> Thing:
        """The thing of this name.

        Raises:
            InputError: for a name that nobody registered, with those that there are.
        """
        self._built_in()
        if name not in self._things:
            raise InputError(
                f"unknown {self.kind} {name!r}: there are {', '.join(self._things)} "
                "(--plugin brings one's own)"
            )
        return self._things[name]

    def __contains__(self, name: object) -> bool:
        self._built_in()
        return name in self._things

    def __iter__(self) -> Iterator[str]:
        self._built_in()
        return iter(self._things)

    def __len__(self) -> int:
        self._built_in()
        return len(self._things)

    def _built_in(self, *, registering: bool = False) -> None:
        """Register what the package brings, once; who looks something up waits for that.

        Who registers does not: it may be a module that the thread which loads waits for.
        """
        if self._ready or not self._lock.acquire(blocking=not registering):
            return
        try:
            if self._loading:
                return
            self._loading = True
            try:
                self._load()
            finally:
                self._loading = False
            # A module that registers is not all there yet.
            self._ready = not registering
        finally:
            self._lock.release()
