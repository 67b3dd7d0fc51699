"""Components and plugins that a test adds are gone after it, so tests need not follow another."""

import contextlib
import re
import sys
from collections.abc import Iterator
from types import ModuleType

from neurosym_jax import plugins
from neurosym_jax.data.tables import FORMATS
from neurosym_jax.evaluation.metrics import METRICS
from neurosym_jax.models.forecaster import FORECASTERS
from neurosym_jax.models.sgan.network import CELLS, POOLINGS
from neurosym_jax.symbolic.events import EVENTS
from neurosym_jax.symbolic.weighting import WEIGHTINGS

TABLES = (FORMATS, METRICS, FORECASTERS, POOLINGS, CELLS, EVENTS, WEIGHTINGS)
DIGEST = re.compile("[0-9a-f]{8}")


@contextlib.contextmanager
def restored_registrations() -> Iterator[None]:
    """Afterwards the tables of components and the plugins that are loaded are as before."""
    plugins.load_entry_points()  # Once in a process: what they register stays.
    before = [dict.copy(table) for table in TABLES]
    loaded, modules = dict(plugins._loaded), _plugin_modules()
    try:
        yield
    finally:
        for table, content in zip(TABLES, before):
            table.clear()
            table.update(content)
        forget_plugins()
        plugins._loaded.update(loaded)
        sys.modules.update(modules)


def forget_plugins() -> None:
    """Let files of plugins be imported again when they are asked for."""
    plugins._loaded.clear()
    for name in _plugin_modules():
        del sys.modules[name]


def _plugin_modules() -> dict[str, ModuleType]:
    """The modules that files of plugins have become, whose names end in a digest."""
    modules = {}
    for name, module in sys.modules.items():
        # Each test asks twice, of some thousand names: the regular expression is for few.
        if name[-9:-8] == "_" and DIGEST.fullmatch(name[-8:]):
            modules[name] = module
    return modules
