"""Files and modules of the user's own that register metrics, forecasters, poolings and so on."""

import hashlib
import importlib
import importlib.util
import sys
from collections.abc import Iterable
from pathlib import Path

from neurosym_jax.errors import InputError

__all__ = ["load_plugin", "loaded", "names"]

_loaded: dict[str, None] = {}


def load_plugin(plugin: str) -> None:
    """Import `plugin`, a path that ends in `.py` or the name of a module, unless that was done.

    Raises:
        InputError: naming it, where it is not there or fails.
    """
    try:
        if plugin.endswith(".py"):
            _load_file(Path(plugin))
        else:
            importlib.import_module(plugin)
    except InputError as error:
        raise InputError(f"plugin {plugin}: {error}") from None
    except Exception as error:  # It is somebody's own code, which can fail in any way.
        reason = f"{type(error).__name__}: {error}"
        raise InputError(f"plugin {plugin}: cannot be imported ({reason})") from error
    _loaded[plugin] = None


def loaded() -> list[str]:
    """What `load_plugin` was called with, in order, so that another process can load it too."""
    return list(_loaded)


def names(plugins: Iterable[str]) -> tuple[str, ...]:
    """What `plugins` are called wherever they lie: modules by name, files without their folder."""
    return tuple(Path(each).name if each.endswith(".py") else each for each in plugins)


def _load_file(path: Path) -> None:
    path = path.resolve()
    # By its whole path, so that two files of one name are two modules.
    name = f"{path.stem}_{hashlib.blake2b(bytes(path), digest_size=4).hexdigest()}"
    if name in sys.modules:
        return
    if not path.is_file():
        raise InputError("no such file")
    spec = importlib.util.spec_from_file_location(name, path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    try:
        spec.loader.exec_module(module)
    except BaseException:
        del sys.modules[name]
        raise
