"""Forecasters: networks and baselines as functions of one scene, and models on disk."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
