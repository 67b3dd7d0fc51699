"""NeuroSyM's pooling: SGAN's, with the pair's relative history weighted step by step by alpha.

Three variants, told apart in `docs/symbols.md`: the papers' (`as_described`), the robot package's
(`neurosym_ros`) and the earlier release's with its defects (`neurosym_ijcnn`). alpha is an
argument, so that any weighting can be tried and differentiated through.
"""

import jax.numpy as jnp
from flax import linen as nn
from jax import Array

from neurosym_jax.errors import InputError
from neurosym_jax.models.layers import Affine, Perceptron
from neurosym_jax.models.pairs import max_over_neighbours
from neurosym_jax.models.pooling import NOT_OF_PAIRS

__all__ = ["IjcnnPooling", "RosPooling", "SymbolicPooling"]


class _HistoryPooling(nn.Module):
    """What the variants share: their sizes and the pair perceptron over all steps and h_j."""

    obs_len: int
    embedding_dim: int
    h_dim: int
    hidden_dim: int
    bottleneck_dim: int

    def declare(self, inputs: int, outputs: int) -> None:
        """Declare the embedding `inputs -> outputs` and the perceptron of a pair."""
        self.spatial_embedding = Affine(inputs, outputs)
        width = self.obs_len * self.embedding_dim
        self.mlp = Perceptron((width + self.h_dim, self.hidden_dim, self.bottleneck_dim))


class SymbolicPooling(_HistoryPooling):
    """As described: each step's `Dense(X_j(t) - X_i(t))` times `alpha_ij(t)`, beside h_j.

    The first layer of the pair perceptron is linear in `[alpha dx, alpha dy, alpha]` of each step,
    so the embedding folds into it: 3 inputs a step instead of `embedding_dim`.
    """

    def setup(self):
        """Declare the embedding, shared over time, and the pair perceptron."""
        self.declare(2, self.embedding_dim)

    def __call__(self, hidden: Array, observed: Array, valid: Array, alpha: Array) -> Array:
        """Social vectors `[N, bottleneck_dim]`.

        Args:
            hidden: [N, H] encoder states.
            observed: [N, obs_len, 2] metres.
            valid: [N] bool.
            alpha: [N, N, obs_len] weight of j's step for i.
        """
        first, second = self.mlp.layers
        of_steps, of_hidden = jnp.split(first.kernel, [self.obs_len * self.embedding_dim])
        of_steps = of_steps.reshape(self.obs_len, self.embedding_dim, self.hidden_dim)
        # [3, obs_len, hidden_dim]: what alpha dx, alpha dy and alpha of each step contribute.
        dense = self.spatial_embedding
        embedding = jnp.concatenate([dense.kernel, dense.bias[None]])
        folded = jnp.einsum("ce,teh->cth", embedding, of_steps)
        folded = folded.reshape(3 * self.obs_len, self.hidden_dim)
        of_neighbour = hidden @ of_hidden + first.bias

        return max_over_neighbours(
            _described_pair, folded, observed, (observed, of_neighbour), alpha, second, valid
        )


def _described_pair(folded: Array, own: Array, theirs: tuple[Array, Array], alpha: Array) -> Array:
    observed, of_neighbour = theirs
    x, y = (observed - own).T
    return jnp.concatenate([alpha * x, alpha * y, alpha]) @ folded + of_neighbour


class RosPooling(_HistoryPooling):
    """The robot package: one Linear over the whole flattened history, then alpha by step.

    Block t of its output, `embedding_dim` channels, is multiplied by `alpha_ij(t)`, but mixes all
    steps. The Linear splits into per-agent parts because the history is a difference.
    """

    def setup(self):
        """Declare the embedding of the history and the pair perceptron."""
        self.declare(2 * self.obs_len, self.obs_len * self.embedding_dim)

    def __call__(self, hidden: Array, observed: Array, valid: Array, alpha: Array) -> Array:
        """Social vectors `[N, bottleneck_dim]`; arguments as in `SymbolicPooling`."""
        first, second = self.mlp.layers
        agents = observed.shape[0]
        of_steps, of_hidden = jnp.split(first.kernel, [self.obs_len * self.embedding_dim])
        own = observed.reshape(agents, -1) @ self.spatial_embedding.kernel
        shifted = own + self.spatial_embedding.bias
        of_neighbour = hidden @ of_hidden + first.bias

        shifted, own = (x.reshape(agents, self.obs_len, -1) for x in (shifted, own))
        return max_over_neighbours(
            _ros_pair, of_steps, own, (shifted, of_neighbour), alpha, second, valid
        )


def _ros_pair(of_steps: Array, own: Array, theirs: tuple[Array, Array], alpha: Array) -> Array:
    shifted, of_neighbour = theirs
    weighted = (shifted - own) * alpha[:, None]
    return weighted.ravel() @ of_steps + of_neighbour


class IjcnnPooling(_HistoryPooling):
    """The earlier release: its relative history is identically zero, so nothing depends on i.

    What is left of the embedding is its bias, times a row of alpha that the released collation
    picked for agent j; everybody gets the same maximum over j.
    """

    def setup(self):
        """Declare the embedding (of which only the bias acts) and the perceptron."""
        self.declare(2, self.embedding_dim)

    def __call__(self, hidden: Array, observed: Array, valid: Array, alpha: Array) -> Array:
        """Social vectors `[N, bottleneck_dim]`, every row the same; `alpha [N, obs_len]`.

        Raises:
            InputError: where alpha is not by agents, as any weighting of pairs.
        """
        if alpha.shape != (len(hidden), self.obs_len):
            raise InputError(f"neurosym_ijcnn {NOT_OF_PAIRS}")
        embedded = alpha[..., None] * self.spatial_embedding.bias
        each = self.mlp(jnp.concatenate([embedded.reshape(len(hidden), -1), hidden], axis=-1))
        highest = jnp.where(valid[:, None], each, 0).max(axis=0)
        return jnp.broadcast_to(highest, each.shape)
