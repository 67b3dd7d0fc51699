"""QTC symbols of pairs of agents, their neighbourhoods, and the weights taken from them."""

from neurosym_jax.symbolic.cnd import alpha_table
from neurosym_jax.symbolic.qtc import pairwise_qtc_c1, qtc_b1, qtc_c1
from neurosym_jax.symbolic.weighting import make_weighting
from neurosym_jax.symbolic.weighting_config import WeightingConfig, register_weighting

__all__ = [
    "WeightingConfig",
    "alpha_table",
    "make_weighting",
    "pairwise_qtc_c1",
    "qtc_b1",
    "qtc_c1",
    "register_weighting",
]
