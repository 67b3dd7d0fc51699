"""An evaluation by the workers of a cluster: each test set, with all models, is one's work."""

import dataclasses
import functools
from collections.abc import Callable, Iterator, Sequence

import jax

from neurosym_jax.data.batching import make_batches
from neurosym_jax.errors import InputError
from neurosym_jax.evaluation.load import Test
from neurosym_jax.evaluation.run import Result, Settings, each_result
from neurosym_jax.runtime.cluster import over_cluster
from neurosym_jax.runtime.process import enable_compilation_cache, tune
from neurosym_jax.runtime.progress import Progress

__all__ = ["evaluator"]

Evaluator = Callable[[Sequence[Test], Settings], Iterator[Result]]


def evaluator(address: str | None) -> Evaluator:
    """`each_result`, by the workers of the cluster at `address` where one is given.

    Raises:
        InputError: where this process is one of several that share the work already.
    """
    if address and jax.process_count() > 1:
        raise InputError("--cluster and --processes: one of them")
    return functools.partial(_over_cluster, address) if address else each_result


def _over_cluster(address: str, tests: Sequence[Test], settings: Settings) -> Iterator[Result]:
    """In the order of the tests; later ones are worked on meanwhile."""
    # Batches are windows once more: they are made where they are needed.
    items = [(dataclasses.replace(test, batches=[]), settings) for test in tests]
    done: dict[int, list[Result]] = {}
    following = 0
    with Progress(sum(len(test.entries) for test in tests), "evaluating", "model") as progress:
        for place, results, reason in over_cluster(address, _results, items):
            if reason:
                raise InputError(f"{tests[place].test_set.dataset}: {reason}")
            done[place] = results
            while following in done:
                for result in done.pop(following):
                    progress.step(f"{result.name} on {result.test_set.dataset}")
                    yield result
                following += 1


def _results(item: tuple[Test, Settings]) -> list[Result]:
    """On a worker."""
    test, settings = item
    tune()
    enable_compilation_cache()
    test = dataclasses.replace(test, batches=make_batches(test.windows))
    return list(each_result([test], settings))
