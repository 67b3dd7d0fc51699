"""Flax networks, each written for one scene; batches and samples are added by `jax.vmap`."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
