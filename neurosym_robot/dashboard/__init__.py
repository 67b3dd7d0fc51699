"""A view of people and their forecasts: one web page, live over HTTP or as a file to share."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
