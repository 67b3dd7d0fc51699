"""Every figure: arrays in, a `matplotlib.figure.Figure` out.

`pyplot` is not used and `rcParams` stay as they are, so figures need no display.
`neurosym.mplstyle` and `style` hold their common look. Sizes are those of a two-column
paper.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
