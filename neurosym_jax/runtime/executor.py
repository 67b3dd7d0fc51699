"""Independent tasks in parallel: single-threaded processes on this machine, or a Dask cluster.

Code that has many tasks is written against `concurrent.futures.Executor` and does not know which of
the two it is given. Tasks and results are pickled; plugins are loaded where a task runs.
"""

import contextlib
import multiprocessing
import os
import pickle
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor, Future, ProcessPoolExecutor
from typing import Any

from neurosym_jax.errors import InputError
from neurosym_jax.plugins import load_entry_points, load_plugin, loaded

__all__ = ["executor"]

SECONDS_TO_ANSWER = 10


@contextlib.contextmanager
def executor(jobs: int | None = None, cluster: str | None = None) -> Iterator[Executor]:
    """Yield an executor; when the context ends by an error, tasks that still run are ended.

    Args:
        jobs: processes on this machine; None for one a core.
        cluster: address of a Dask scheduler, such as `tcp://HOST:8786`, in place of them. Its
            workers have this package installed. A task whose worker dies is done by another, three
            times at most. Whoever reaches a Dask scheduler can run any code on its workers.

    Raises:
        InputError: for both, for no job, where Dask is not installed or no scheduler answers.
    """
    if cluster is not None:
        if jobs is not None:
            raise InputError("--jobs and --cluster: a cluster has as many jobs as its workers")
        with _dask_client(cluster) as client:
            yield _WithPlugins(client.get_executor(pure=False))
        return
    if jobs is not None and jobs < 1:
        raise InputError(f"--jobs must be at least 1, not {jobs}")
    from neurosym_jax.runtime.environment import cpu_cores

    before = set(multiprocessing.active_children())
    # Forked processes would share the threads and locks of JAX, which they do not have.
    spawn = multiprocessing.get_context("spawn")
    pool = ProcessPoolExecutor(jobs or cpu_cores(), spawn, _begin_process)
    try:
        yield _WithPlugins(pool)
    except BaseException:
        pool.shutdown(wait=False, cancel_futures=True)
        for child in set(multiprocessing.active_children()) - before:
            child.terminate()
        raise
    pool.shutdown()


class _WithPlugins(Executor):
    """An executor whose tasks load the plugins of this process first.

    Tasks travel as bytes: objects of a plugin's classes can be unpickled once it is loaded only.
    """

    def __init__(self, inner: Executor):
        self._inner = inner

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future:
        plugins = [os.path.abspath(each) if each.endswith(".py") else each for each in loaded()]
        return self._inner.submit(_call, plugins, pickle.dumps((fn, args, kwargs)))


def _call(plugins: Sequence[str], task: bytes) -> Any:
    load_entry_points()
    for plugin in plugins:
        load_plugin(plugin)
    function, args, kwargs = pickle.loads(task)
    return function(*args, **kwargs)


def _begin_process() -> None:
    """Set up a process of the pool, before JAX's backend starts in it."""
    # One thread is as fast at these sizes, and gives the same bits wherever it runs.
    os.environ["NPROC"] = "1"
    from neurosym_jax.runtime.process import enable_compilation_cache, tune

    tune()
    enable_compilation_cache()
    parent = multiprocessing.parent_process()
    assert parent is not None

    def follow() -> None:
        parent.join()
        os._exit(1)

    threading.Thread(target=follow, daemon=True).start()


def _dask_client(address: str) -> Any:
    try:
        from distributed import Client
    except ImportError:
        raise InputError("--cluster needs Dask: pip install 'neurosym-jax[cluster]'") from None
    try:
        client = Client(address, timeout=SECONDS_TO_ANSWER, set_as_default=False)
    except (OSError, ValueError) as error:
        raise InputError(f"--cluster {address}: no Dask scheduler answers ({error})") from None
    threads: Any = client.nthreads()
    print(f"cluster: {len(threads)} workers", file=sys.stderr)
    return client
