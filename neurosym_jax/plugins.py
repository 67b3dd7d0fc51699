"""Tables of components (metrics, forecasters, poolings, ...), and the plugins that add to them.

Each package shows its built-ins in one table, such as `POOLINGS = Registry("pooling",
{...})`; a file or module given by `--plugin`, or an installed package, adds to it with
`register`.

An installed package joins by its entry points: a module in the group
`neurosym_jax.plugins`, which registers, and in `neurosym_jax.commands` a module for
each command of `neurosym`.
"""

import difflib
import functools
import hashlib
import importlib
import importlib.util
import sys
import typing
import warnings
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, TypeVar

from neurosym_jax.errors import InputError, InputWarning, brief, option

__all__ = [
    "Registry",
    "additions",
    "entry_points",
    "installed_version",
    "load_entry_points",
    "load_plugin",
    "loaded",
    "names",
]

T = TypeVar("T")

_loaded: dict[str, None] = {}
_additions: list[tuple[str, str, Any]] = []


class _Later(typing.NamedTuple):
    """A component that is not imported yet."""

    place: str


class Registry(dict[str, T]):
    """Components of one kind by name, in the order in which they were registered."""

    def __init__(
        self,
        kind: str,
        built_in: Mapping[str, T] | None = None,
        *,
        modules: Mapping[str, str] | None = None,
    ):
        """Hold `built_in`; `kind` is what messages call one of them, such as "pooling".

        `modules` has the component's name in its module, `MODULE:NAME`, for components
        that are imported when they are first asked for.
        """
        super().__init__(built_in or {})
        self.kind = kind
        for name, place in (modules or {}).items():
            super().__setitem__(name, typing.cast(T, _Later(place)))

    def register(
        self, name: str, value: T | None = None, *, replace: bool = False
    ) -> Any:
        """Add `value` and return it; without `value`, return a decorator of the component.

        `replace` replaces another component of this name, and clears JAX's compilation
        cache, which finds programs by name.

        Raises:
            InputError: if `name` is not an identifier or is taken by another component.
        """
        self.refuse_name(name)
        if value is None:
            return functools.partial(self.register, name, replace=replace)
        if name in self and self[name] != value:
            self.refuse_taken(name, replace)
            import jax

            jax.clear_caches()
        self[name] = value
        return value

    def refuse_name(self, name: Any) -> None:
        """Refuse what cannot name a component, such as one whose decorator has no name.

        Raises:
            InputError: saying how it must be written.
        """
        if not isinstance(name, str):
            raise InputError(
                f'a {self.kind} needs a name: @register_{self.kind}("name")'
            )
        if not name.isidentifier():
            raise InputError(
                f"{name!r} cannot name a {self.kind}: letters, digits, underscores"
            )

    def refuse_taken(self, name: str, replace: bool) -> None:
        """Refuse the name of another component, unless it is to be replaced.

        Raises:
            InputError: with both ways out.
        """
        if name in self and not replace:
            taken = f"there is another {self.kind} {name!r} already"
            raise InputError(f"{taken}: choose another name, or say replace=True")

    def name_of(self, value: Any) -> str:
        """The name of `value`, or of its class.

        Raises:
            InputError: if neither is registered.
        """
        # Those imported come first: of the others none may be needed.
        for components in (self.imported(), self.items()):
            for name, component in components:
                if component is value or component is type(value):
                    return name
        raise InputError(f"{brief(value)} is not registered as a {self.kind}")

    def __getitem__(self, name: str) -> T:
        """The component `name`, imported if need be."""
        value: Any = super().__getitem__(name)
        if isinstance(value, _Later):
            module, _, attribute = value.place.partition(":")
            value = getattr(importlib.import_module(module), attribute)
            super().__setitem__(name, value)
        return value

    def __setitem__(self, name: str, value: T) -> None:
        """Add or replace a component."""
        super().__setitem__(name, value)
        _additions.append((self.kind, name, value))

    def imported(self) -> list[tuple[str, T]]:
        """Names and components, without those that were not asked for yet."""
        components = [(name, super(Registry, self).__getitem__(name)) for name in self]
        return [item for item in components if not isinstance(item[1], _Later)]

    def values(self) -> list[T]:  # pyright: ignore[reportIncompatibleMethodOverride]
        """All components, imported."""
        return [self[name] for name in self]

    def items(self) -> list[tuple[str, T]]:  # pyright: ignore[reportIncompatibleMethodOverride]
        """Names and components, imported."""
        return [(name, self[name]) for name in self]

    def __missing__(self, name: str) -> T:
        near = difflib.get_close_matches(str(name)[:80], self, 1)
        hint = f"did you mean {near[0]!r}? " if near else ""
        names = f"there are {', '.join(self)} ({option('plugin', 'FILE')} adds one)"
        raise InputError(f"unknown {self.kind} {brief(name)}: {hint}{names}")


@functools.cache
def entry_points(group: str) -> Mapping[str, str]:
    """Modules that installed packages declare as entry points of `neurosym_jax.GROUP`, by name.

    Kept, because every installed package is asked.
    """
    from importlib import metadata  # 20 ms, not spent on `import neurosym_jax`.

    points = metadata.entry_points(group=f"neurosym_jax.{group}")
    return {point.name: point.value for point in points}


def installed_version() -> str:
    """The version of this package; `not installed` where it runs from its source alone."""
    from importlib import metadata

    try:
        return metadata.version("neurosym-jax")
    except metadata.PackageNotFoundError:
        return "not installed"


@functools.cache
def load_entry_points() -> None:
    """Import the plugins of installed packages, once.

    Warns:
        InputWarning: naming a plugin that cannot be imported.
    """
    for name, module in entry_points("plugins").items():
        try:
            importlib.import_module(module)
        except Exception as error:  # Commands that do not need this package go on.
            text = f"plugin {name} ({module}): {type(error).__name__}: {error}"
            warnings.warn(text, InputWarning, stacklevel=2)


def load_plugin(plugin: str) -> None:
    """Import `plugin`, a path that ends in `.py` or the name of a module, once.

    Raises:
        InputError: naming a plugin that does not exist or fails.
    """
    try:
        if plugin.endswith(".py"):
            _load_file(Path(plugin).resolve())
        else:
            importlib.import_module(plugin)
    except Exception as error:  # A user's own code can fail in any way.
        kind = "" if isinstance(error, InputError) else f"{type(error).__name__}: "
        raise InputError(f"plugin {plugin}: {kind}{error}") from error
    _loaded[plugin] = None


def loaded() -> list[str]:
    """The arguments of `load_plugin` so far, so that another process can load the same."""
    return list(_loaded)


def additions() -> list[tuple[str, str, Any]]:
    """Kind, name and value of each component that was added to a table, in order."""
    return _additions


def names(plugins: Iterable[str]) -> tuple[str, ...]:
    """Names of `plugins` on any machine, each once: modules, and files without their folder."""
    unique = {}
    for plugin in plugins:
        name = Path(plugin).name if plugin.endswith(".py") else plugin
        unique[name] = None
    return tuple(unique)


def _load_file(path: Path) -> None:
    # By its whole path, so that two files of one name are two modules.
    name = f"{path.stem}_{hashlib.blake2b(bytes(path), digest_size=4).hexdigest()}"
    if name in sys.modules:
        return
    if not path.is_file():
        raise InputError("no such file")
    spec: Any = importlib.util.spec_from_file_location(name, path)
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    try:
        spec.loader.exec_module(module)
    except BaseException:
        del sys.modules[name]
        raise
