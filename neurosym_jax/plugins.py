"""Files, modules and installed packages that register metrics, forecasters, poolings and so on.

An installed package joins by its entry points: a module in the group `neurosym_jax.plugins`, which
registers, and in `neurosym_jax.commands` a module for each command of `neurosym`.
"""

import functools
import hashlib
import importlib
import importlib.util
import sys
import warnings
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from neurosym_jax.errors import InputError, InputWarning

__all__ = ["entry_points", "load_entry_points", "load_plugin", "loaded", "names"]

_loaded: dict[str, None] = {}


def entry_points(group: str) -> dict[str, str]:
    """Modules that installed packages declare as entry points of `neurosym_jax.GROUP`, by name."""
    from importlib import metadata  # 20 ms, not spent on `import neurosym_jax`.

    return {each.name: each.value for each in metadata.entry_points(group=f"neurosym_jax.{group}")}


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
            _load_file(Path(plugin))
        else:
            importlib.import_module(plugin)
    except InputError as error:
        raise InputError(f"plugin {plugin}: {error}") from None
    except Exception as error:  # A user's own code can fail in any way.
        raise InputError(f"plugin {plugin}: {type(error).__name__}: {error}") from error
    _loaded[plugin] = None


def loaded() -> list[str]:
    """The arguments of `load_plugin` so far, so that another process can load the same."""
    return list(_loaded)


def names(plugins: Iterable[str]) -> tuple[str, ...]:
    """Names of `plugins` on any machine, each once: modules, and files without their folder."""
    named = (Path(each).name if each.endswith(".py") else each for each in plugins)
    return tuple(dict.fromkeys(named))


def _load_file(path: Path) -> None:
    path = path.resolve()
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
