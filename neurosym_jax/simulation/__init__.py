"""The embedded recordings: people of a social-force model, seen by a faulty tracker."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
