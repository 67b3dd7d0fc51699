"""The poolings that the package brings, as a plugin would register its own.

Modules are imported when one is made, since a configuration is checked without Flax.
"""

from neurosym_jax.config import GeneratorConfig
from neurosym_jax.models.pooling import register_pooling

__all__ = []


def _pool_net(config: GeneratorConfig, h_dim: int):
    from neurosym_jax.models.hidden_pooling import HiddenPooling

    return HiddenPooling(*_sizes(config, h_dim))


def _social(config: GeneratorConfig, h_dim: int):
    from neurosym_jax.models.social_pooling import SocialPooling

    return SocialPooling(h_dim, config.grid_size, config.neighborhood_size)


def _as_described(config: GeneratorConfig, h_dim: int):
    from neurosym_jax.models.symbolic_pooling import SymbolicPooling

    return SymbolicPooling(config.obs_len, *_sizes(config, h_dim))


def _neurosym_ros(config: GeneratorConfig, h_dim: int):
    from neurosym_jax.models.symbolic_pooling import RosPooling

    return RosPooling(config.obs_len, *_sizes(config, h_dim))


def _neurosym_ijcnn(config: GeneratorConfig, h_dim: int):
    from neurosym_jax.models.symbolic_pooling import IjcnnPooling

    return IjcnnPooling(config.obs_len, *_sizes(config, h_dim))


def _encounter(config: GeneratorConfig, h_dim: int):
    from neurosym_jax.models.encounter_pooling import EncounterPooling

    return EncounterPooling(config.pool_hidden_dim, config.bottleneck_dim)


def _sizes(config: GeneratorConfig, h_dim: int) -> tuple[int, int, int, int]:
    return config.embedding_dim, h_dim, config.pool_hidden_dim, config.bottleneck_dim


register_pooling("none", None, label="SGAN, no pooling")
register_pooling("pool_net", _pool_net, label="SGAN")
register_pooling(
    "social",
    _social,
    label="SGAN, social pooling",
    returns_hidden=True,
    pair_numbers=lambda config: 2.0 * config.grid_size**2,
)
register_pooling("as_described", _as_described, label="NeuroSyM", symbolic=True)
register_pooling("neurosym_ros", _neurosym_ros, label="NeuroSyM (robot package)", symbolic=True)
register_pooling(
    "encounter",
    _encounter,
    label="NeuroSyM, encounter pooling",
    symbolic=True,
    pair_numbers=lambda config: 3.0 * config.pool_hidden_dim,
)
register_pooling(
    "neurosym_ijcnn",
    _neurosym_ijcnn,
    label="NeuroSyM (IJCNN release)",
    symbolic=True,
    of_pairs=False,
)
