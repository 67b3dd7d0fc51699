"""The table of poolings, with the built-in ones; a plugin adds to it.

Networks are imported when one is made, since a configuration is checked without Flax.
"""

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from neurosym_jax.models.pooling import Pooling
from neurosym_jax.registry import Registry

if TYPE_CHECKING:
    from neurosym_jax.config import GeneratorConfig

__all__ = ["POOLINGS", "make_pooling", "pooling_names", "register_pooling"]


def _pool_net(config: "GeneratorConfig", h_dim: int):
    from neurosym_jax.models.hidden_pooling import HiddenPooling

    return HiddenPooling(*_sizes(config, h_dim))


def _social(config: "GeneratorConfig", h_dim: int):
    from neurosym_jax.models.social_pooling import SocialPooling

    return SocialPooling(h_dim, config.grid_size, config.neighborhood_size)


def _as_described(config: "GeneratorConfig", h_dim: int):
    from neurosym_jax.models.symbolic_pooling import SymbolicPooling

    return SymbolicPooling(config.obs_len, *_sizes(config, h_dim))


def _neurosym_ros(config: "GeneratorConfig", h_dim: int):
    from neurosym_jax.models.symbolic_pooling import RosPooling

    return RosPooling(config.obs_len, *_sizes(config, h_dim))


def _neurosym_ijcnn(config: "GeneratorConfig", h_dim: int):
    from neurosym_jax.models.symbolic_pooling import IjcnnPooling

    return IjcnnPooling(config.obs_len, *_sizes(config, h_dim))


def _encounter(config: "GeneratorConfig", h_dim: int):
    from neurosym_jax.models.encounter_pooling import EncounterPooling

    return EncounterPooling(config.pool_hidden_dim, config.bottleneck_dim)


def _sizes(config: "GeneratorConfig", h_dim: int) -> tuple[int, int, int, int]:
    return config.embedding_dim, h_dim, config.pool_hidden_dim, config.bottleneck_dim


POOLINGS: Registry[Pooling] = Registry(
    "pooling",
    {
        "none": Pooling(None, label="SGAN, no pooling"),
        "pool_net": Pooling(_pool_net, label="SGAN"),
        "social": Pooling(
            _social,
            label="SGAN, social pooling",
            returns_hidden=True,
            pair_numbers=lambda config: 2.0 * config.grid_size**2,
        ),
        "as_described": Pooling(_as_described, label="NeuroSyM", symbolic=True),
        "neurosym_ros": Pooling(_neurosym_ros, label="NeuroSyM (robot package)", symbolic=True),
        "encounter": Pooling(
            _encounter,
            label="NeuroSyM, encounter pooling",
            symbolic=True,
            pair_numbers=lambda config: 3.0 * config.pool_hidden_dim,
        ),
        "neurosym_ijcnn": Pooling(
            _neurosym_ijcnn,
            label="NeuroSyM (IJCNN release)",
            symbolic=True,
            of_pairs=False,
        ),
    },
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
