"""Work that the workers of a Dask cluster do, for `--cluster ADDRESS`; the extra `cluster`.

What a worker was at when it died is done by another, three times at most. Workers have this package
installed. Whoever reaches a Dask scheduler can run any code on its workers: keep it to those who
may.
"""

import contextlib
import os
import pickle
import sys
import warnings
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import CancelledError
from typing import Any

from neurosym_jax.errors import InputError
from neurosym_jax.plugins import load_plugin, loaded

__all__ = ["over_cluster"]

SECONDS_TO_ANSWER = 10


def over_cluster(
    address: str,
    work: Callable[[Any], Any],
    items: Sequence[Any],
    afterwards: Callable[[], None] | None = None,
) -> Iterator[tuple[int, Any, str]]:
    """For each item, in the order in which they are done, its place and what came of it.

    Args:
        address: of the scheduler, such as `tcp://HOST:8786`.
        work: a function of this package; called on a worker with an item.
        items: what it is called with; pickled, as what it gives.
        afterwards: called once on every worker that is left, however this ends.

    Yields:
        Place among the items, what `work` gave, and why it failed, empty where it did not.

    Raises:
        InputError: where Dask is not installed, no scheduler answers, or it goes away.
    """
    try:
        from distributed import Client, as_completed
    except ImportError:
        raise InputError("--cluster needs Dask: pip install 'neurosym-jax[cluster]'") from None
    try:
        client = Client(address, timeout=SECONDS_TO_ANSWER, set_as_default=False)
    except (OSError, ValueError) as error:
        raise InputError(f"--cluster {address}: no Dask scheduler answers ({error})") from None
    # A plugin's classes can be unpickled only where it was loaded, so items travel as bytes.
    plugins = [os.path.abspath(each) if each.endswith(".py") else each for each in loaded()]
    with client:
        threads: Any = client.nthreads()
        of = f"{len(threads)} workers, {sum(threads.values())} threads"
        print(f"cluster: {of if threads else 'no worker yet'}", file=sys.stderr)
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", UserWarning)  # That items are large.
                places = {
                    client.submit(_do, plugins, work, pickle.dumps(item), pure=False): place
                    for place, item in enumerate(items)
                }
            for future in as_completed(list(places), loop=client.loop):
                error: Any = future.exception()
                yield places.pop(future), None if error else future.result(), _reason(error)
        except (CancelledError, OSError):
            raise InputError(
                f"--cluster {address}: the scheduler went away; what was finished is kept"
            ) from None
        finally:
            if afterwards:
                with contextlib.suppress(OSError):  # Where there is no scheduler any more.
                    client.run(afterwards)


def _do(plugins: Sequence[str], work: Callable[[Any], Any], item: bytes) -> Any:
    for plugin in plugins:
        load_plugin(plugin)
    return work(pickle.loads(item))


def _reason(error: Exception | None) -> str:
    from distributed import KilledWorker

    if error is None:
        return ""
    if isinstance(error, KilledWorker):
        return "the workers that were at it died, one after another"
    return str(error) if isinstance(error, InputError) else f"{type(error).__name__}: {error}"
