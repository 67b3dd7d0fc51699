"""Fetch ETH/UCY or SGAN's checkpoints; say how to get THÖR."""

from neurosym_jax.data.download import DownloadOptions as Options
from neurosym_jax.data.download import download as run

__all__ = ["Options", "run"]
