"""The table of poolings."""

from neurosym_jax.models.encounter import Encounter
from neurosym_jax.models.neurosym import AsDescribed, NeurosymIjcnn, NeurosymRos
from neurosym_jax.models.pool_net import PoolNet
from neurosym_jax.models.pooling import NoPooling, Pooling
from neurosym_jax.models.social import Social
from neurosym_jax.plugins import Registry

__all__ = ["POOLINGS", "pooling_names", "register_pooling"]

POOLINGS: Registry[type[Pooling]] = Registry(
    "pooling",
    {
        "none": NoPooling,
        "pool_net": PoolNet,
        "social": Social,
        "as_described": AsDescribed,
        "neurosym_ros": NeurosymRos,
        "encounter": Encounter,
        "neurosym_ijcnn": NeurosymIjcnn,
    },
)

register_pooling = POOLINGS.register


def pooling_names(*, symbolic: bool) -> tuple[str, ...]:
    """Names of the poolings that can be trained: NeuroSyM's, which take alpha, or the others."""
    return tuple(
        name
        for name, pooling in POOLINGS.items()
        if ("alpha" in pooling.inputs) == symbolic and "alpha_rows" not in pooling.inputs
    )
