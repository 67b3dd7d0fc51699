"""Poolings by name: what a generator's configuration can name, and what a plugin adds.

This is the list and not the networks: Flax is imported when one is made. The package's own are
registered in `built_in_poolings`.
"""

import dataclasses
import importlib
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from neurosym_jax.registry import Registry

if TYPE_CHECKING:
    from neurosym_jax.config import GeneratorConfig

__all__ = [
    "NOT_OF_PAIRS",
    "POOLINGS",
    "Pooling",
    "make_pooling",
    "pooling_names",
    "register_pooling",
]

NOT_OF_PAIRS = (
    "does not weight pairs: it takes one row of alpha an agent, picked by the released collation "
    "out of other scenes' pairs, so it forecasts in parity cases only"
)
"""After the name of a pooling that is not `of_pairs`."""


@dataclasses.dataclass(frozen=True)
class Pooling:
    """A pooling over the neighbours in one scene, `[N, H]` hidden states to `[N, B]` vectors.

    Its module is called with `(hidden [N, H], positions [N, 2], valid [N])`. It gives a finite
    vector for every slot, and lets only agents contribute that are valid. B is the configuration's
    `bottleneck_dim`.
    """

    module: Callable[["GeneratorConfig", int], Any] | None
    """Flax module of `(config, h_dim)`, H being `h_dim`; None where there is nothing to pool."""
    label: str
    """What a model with it is called in tables."""
    symbolic: bool = False
    """Takes `(hidden, observed [N, obs_len, 2], valid, alpha [N, N, obs_len])`: NeuroSyM."""
    whole_observation: bool = False
    """Takes `(hidden, observed [N, obs_len, 2], valid)`, without alpha."""
    returns_hidden: bool = False
    """B is H, so that `bottleneck_dim` must equal it."""
    of_pairs: bool = True
    """Of symbolic ones: False where alpha is `[N, obs_len]`, see `NOT_OF_PAIRS`."""
    pair_numbers: Callable[["GeneratorConfig"], float] = lambda _: 0.0
    """About how many numbers one call keeps for each pair of slots, for the size of batches."""

    @property
    def windowed(self) -> bool:
        """Whether it sees the last `obs_len` positions, at predicted steps too, not only the last.

        At a predicted step they are those seen or predicted before it and at it.
        """
        return self.symbolic or self.whole_observation


POOLINGS: Registry[Pooling] = Registry(
    "pooling", lambda: importlib.import_module("neurosym_jax.models.built_in_poolings")
)


def register_pooling(
    name: str,
    module: Callable[["GeneratorConfig", int], Any] | None,
    *,
    label: str,
    replace: bool = False,
    **properties: Any,
) -> None:
    """Add a pooling, so that models with it can be trained, saved, loaded and evaluated.

    Args:
        name: what a configuration calls it.
        module: a Flax module with the fields `config` and `h_dim`, or a function that makes one of
            them; see `Pooling` for how it is called.
        label: what a model with it is called in tables.
        replace: take the place of another of this name.
        properties: further fields of `Pooling`, such as `symbolic=True`.

    Raises:
        InputError: for a name that is taken or cannot be one.
    """
    POOLINGS.register(name, Pooling(module, label, **properties), replace=replace)


def pooling_names(*, symbolic: bool) -> tuple[str, ...]:
    """Names of those that can be trained: NeuroSyM's, or the others, `none` included."""
    return tuple(
        name
        for name, pooling in POOLINGS.items()
        if pooling.symbolic == symbolic and pooling.of_pairs
    )


def make_pooling(config: "GeneratorConfig", h_dim: int) -> Any:
    """The module that `config` names, for hidden states of size `h_dim`; there must be one."""
    module = POOLINGS[config.pooling].module
    assert module is not None
    return module(config, h_dim)
