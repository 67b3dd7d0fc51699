"""A live view of people and their forecasts: one web page, live over HTTP or as a file to share.

`Dashboard` serves the page and a stream of what happens; `ReplayFile` writes the same page with
everything inside. Both `show` a frame at a time and know nothing of ROS, files of tracks or
models' insides.

The page is `page.html` with `page.css` and the `.js` files in it (`page.py`); `moments.py` says
what it is told and `symbols.py` finds the QTC symbols in it; `server.py` serves it, `stream.py`
is what waits for slow readers, and `floor_map.py` reads the map underneath.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
