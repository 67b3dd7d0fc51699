"""Training of generators and discriminators: recipes, one pure step, and the loop around it."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
