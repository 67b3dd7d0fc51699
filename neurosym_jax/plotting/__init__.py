"""Every figure: arrays in, a `matplotlib.figure.Figure` out.

Neither `pyplot` nor `rcParams` is touched, so that figures need no display and can be drawn by
several threads. A file draws one kind of figure; `style` is what they look alike in, `palette`
their colours. Sizes and letters are those of a two-column paper.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
