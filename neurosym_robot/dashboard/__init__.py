"""A view of people and their forecasts: one web page, live over HTTP or as a file to share.

`Dashboard` serves the page and a stream of events; `ReplayFile` writes the same page with its data
inside. `page.py` assembles the page, `moments.py` describes the stream in JSON.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
