"""What makes the numbers and figures in docs/, a module a question: docs/studies.md lists them."""

import sys
import warnings
from collections.abc import Callable

import polars as pl

__all__ = ["print_or_run"]


def print_or_run(
    report: Callable[[pl.DataFrame], str], run: Callable[..., None]
) -> None:
    """The command of a study: with one word, a table's path, print its report; with more, run."""
    if len(sys.argv) == 2:
        print(report(pl.read_csv(sys.argv[1])))
        return
    from neurosym_jax.errors import InputWarning
    from neurosym_jax.runtime import enable_compilation_cache, tune

    warnings.simplefilter("ignore", InputWarning)
    enable_compilation_cache()
    tune()
    run(*sys.argv[1:])
