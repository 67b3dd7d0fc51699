"""Independent tasks elsewhere: on a process for each core here, or a Dask cluster's workers."""

import contextlib
import multiprocessing
import os
import pickle
import signal
import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from typing import Any

import jax

from neurosym_jax.errors import InputError, option
from neurosym_jax.plugins import load_entry_points, load_plugin, loaded
from neurosym_jax.runtime.ending import SIGNALS, when_ended
from neurosym_jax.runtime.process import cpu_cores, enable_compilation_cache, tune

__all__ = ["Map", "cluster_map", "map_for", "process_map"]

Map = Callable[..., Iterable[Any]]
"""`map` of one argument, whose calls may run at the same time elsewhere."""
WORTH_PROCESSES = 8
"""Tasks from which on it is worth to start processes for them."""


def map_for(
    tasks: int, cluster: str | None = None
) -> contextlib.AbstractContextManager[Map | None]:
    """A `map` for `tasks` of a second each, on a Dask `cluster` or in processes.

    None where few tasks are not worth the start of processes: they are left to threads.
    """
    if cluster:
        return cluster_map(cluster)
    if tasks >= WORTH_PROCESSES and cpu_cores() > 1 and "NPROC" not in os.environ:
        return process_map()
    return contextlib.nullcontext()


@contextlib.contextmanager
def process_map() -> Iterator[Map]:
    """Yield a `map` whose calls are tasks of processes that start now, one for each core.

    Each computes in one thread on a core of its own, and results have the bits of one
    core. The script that calls this must be importable without effects (`if __name__ ==
    "__main__":`).

    Raises:
        InputError: where one of the processes was killed.
    """
    context = multiprocessing.get_context("spawn")
    cores = context.SimpleQueue()
    for core in (
        sorted(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else ()
    ):
        cores.put(core)
    pool = ProcessPoolExecutor(
        cpu_cores(), context, initializer=_begin, initargs=(cores, _plugins())
    )

    def stop() -> None:
        for process in multiprocessing.active_children():
            process.kill()

    with pool, when_ended(stop):
        for _ in range(cpu_cores()):
            # A process starts with a task that none is free for, and JAX with its
            # backend.
            pool.submit(jax.device_count)
        try:
            yield pool.map
        except BrokenProcessPool:
            raise InputError(
                "a process that evaluates was killed, by lack of memory perhaps: NPROC=1 uses one"
            ) from None


def _begin(cores: Any, plugins: Sequence[str]) -> None:
    """Prepare a process of `process_map`, whose parent handles signals of the terminal."""
    for number in SIGNALS:
        signal.signal(number, signal.SIG_IGN)
    if not cores.empty():
        os.sched_setaffinity(0, {cores.get()})
    os.environ["NPROC"] = "1"  # XLA reads it once, when its backend starts.
    tune()
    enable_compilation_cache()
    _load(plugins)


@contextlib.contextmanager
def cluster_map(address: str) -> Iterator[Map]:
    """Yield a `map` whose calls are tasks on the workers, which have this package installed.

    The plugins of this process are loaded there first. A task whose worker dies is done
    by another, three times at most. Whoever reaches a Dask scheduler can run any code
    on its workers.

    Args:
        address: of the scheduler, such as `tcp://HOST:8786`.

    Raises:
        InputError: where Dask is not installed or no scheduler answers.
    """
    try:
        from distributed import Client
    except ImportError:
        raise InputError(
            "a cluster needs Dask: pip install 'neurosym-jax[cluster]'"
        ) from None
    try:
        client = Client(address, timeout=10, set_as_default=False)
    except (OSError, ValueError) as error:
        cluster = option("cluster", address)
        raise InputError(f"{cluster}: no Dask scheduler answers ({error})") from None
    with client:
        workers: Any = client.nthreads()
        print(f"cluster: {len(workers)} workers", file=sys.stderr)
        plugins = _plugins()

        def run(function: Callable[[Any], Any], items: Iterable[Any]) -> Iterator[Any]:
            # As bytes: objects of a plugin's classes can be unpickled once it is loaded
            # only.
            tasks = [pickle.dumps((function, item)) for item in items]
            futures = [
                client.submit(_call, plugins, task, pure=False) for task in tasks
            ]
            return (future.result() for future in futures)

        yield run


def _call(plugins: Sequence[str], task: bytes) -> Any:
    _load(plugins)
    function, item = pickle.loads(task)
    return function(item)


def _plugins() -> list[str]:
    """What another process needs to load, with paths that it can find."""
    return [
        os.path.abspath(name) if name.endswith(".py") else name for name in loaded()
    ]


def _load(plugins: Sequence[str]) -> None:
    load_entry_points()
    for plugin in plugins:
        load_plugin(plugin)
