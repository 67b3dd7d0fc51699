"""Flax networks, each written for one scene; batches and samples are added by `jax.vmap`."""

from neurosym_jax.models.discriminator import Discriminator
from neurosym_jax.models.generator import Generator

__all__ = ["Discriminator", "Generator"]
