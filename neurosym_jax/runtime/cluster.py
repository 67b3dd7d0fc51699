"""Independent tasks on the workers of a Dask cluster."""

import contextlib
import os
import pickle
import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Any

from neurosym_jax.errors import InputError
from neurosym_jax.plugins import load_entry_points, load_plugin, loaded

__all__ = ["cluster_map"]


@contextlib.contextmanager
def cluster_map(address: str) -> Iterator[Callable[..., Iterable[Any]]]:
    """Yield a `map` whose calls are tasks on the workers, which have this package installed.

    The plugins of this process are loaded there first. A task whose worker dies is done by another,
    three times at most. Whoever reaches a Dask scheduler can run any code on its workers.

    Args:
        address: of the scheduler, such as `tcp://HOST:8786`.

    Raises:
        InputError: where Dask is not installed or no scheduler answers.
    """
    try:
        from distributed import Client
    except ImportError:
        raise InputError("--cluster needs Dask: pip install 'neurosym-jax[cluster]'") from None
    try:
        client = Client(address, timeout=10, set_as_default=False)
    except (OSError, ValueError) as error:
        raise InputError(f"--cluster {address}: no Dask scheduler answers ({error})") from None
    with client:
        workers: Any = client.nthreads()
        print(f"cluster: {len(workers)} workers", file=sys.stderr)
        plugins = [
            os.path.abspath(plugin) if plugin.endswith(".py") else plugin for plugin in loaded()
        ]

        def run(function: Callable[[Any], Any], items: Iterable[Any]) -> Iterator[Any]:
            # As bytes: objects of a plugin's classes can be unpickled once it is loaded only.
            tasks = [pickle.dumps((function, item)) for item in items]
            futures = [client.submit(_call, plugins, task, pure=False) for task in tasks]
            return (future.result() for future in futures)

        yield run


def _call(plugins: Sequence[str], task: bytes) -> Any:
    load_entry_points()
    for plugin in plugins:
        load_plugin(plugin)
    function, item = pickle.loads(task)
    return function(item)
