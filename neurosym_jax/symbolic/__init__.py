"""QTC symbols of pairs of agents, their neighbourhoods, and the weights taken from them."""

from neurosym_jax.symbolic.cnd import alpha_table
from neurosym_jax.symbolic.qtc import pairwise_qtc_c1, qtc_b1, qtc_c1
from neurosym_jax.symbolic.weighting import Weighting, pair_alpha

__all__ = ["Weighting", "alpha_table", "pair_alpha", "pairwise_qtc_c1", "qtc_b1", "qtc_c1"]
